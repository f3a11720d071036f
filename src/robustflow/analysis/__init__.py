"""Numbers from rows and from published tables, without models or frames."""
