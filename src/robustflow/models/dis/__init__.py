"""Dense inverse search on colour frames, one step of the method a file."""
