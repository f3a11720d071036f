"""Noise corruptions, independent from frame to frame (paper, appendix "Noise corruptions")."""
