"""Gaussian, defocus, glass, camera-motion and lens blur."""
