"""The "blur" family of corruptions: Gaussian, defocus, glass, camera motion and lens blur."""
