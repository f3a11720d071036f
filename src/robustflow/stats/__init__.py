"""Statistics computed from result rows and published tables, without running models or reading frames."""
