"""Lenses: prescriptions, ray tracing, the search that found them, and the PSF fields they give."""
