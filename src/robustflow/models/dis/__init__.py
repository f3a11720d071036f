"""Dense inverse search on colour frames, with one module for each step of the method."""
