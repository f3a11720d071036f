"""Pages made from the code; each module has `files()`: path in the site -> text or bytes."""
