"""Point spread functions at run time: their variation over a lens's field, interpolation between nodes, and the blur."""
