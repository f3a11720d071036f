"""Point spread functions at run time: the field of a lens, tiles, and the blur."""
