"""Counter-based random streams, named by what they are drawn for."""
