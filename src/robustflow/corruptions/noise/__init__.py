"""Corruptions of the family "noise", independent in each frame (paper, appendix "Noise corruptions")."""
