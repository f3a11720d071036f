"""Point spread functions at run time: PSF fields, interpolation between nodes, and blurring."""
