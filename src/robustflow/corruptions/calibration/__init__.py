"""Calibrate severities so that corruptions are comparable: paths, search and SSIM."""
