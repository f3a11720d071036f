"""Numbers from rows and from published tables; no model, no frame."""
