"""Pages generated from the code; each module has a function `files()` that maps a path in the site to text or bytes."""
