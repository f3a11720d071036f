"""Calibration of severities to make corruptions comparable: paths, search and SSIM."""
