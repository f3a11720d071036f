"""Corruptions of the family "blur": Gaussian, defocus, glass, camera motion and lens blur."""
