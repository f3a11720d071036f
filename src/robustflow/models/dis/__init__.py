"""Dense inverse search on colour frames, with one file per step of the method."""
