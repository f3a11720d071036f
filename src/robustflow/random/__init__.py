"""Counter-based random streams, each named after its purpose."""
