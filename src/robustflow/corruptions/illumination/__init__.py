"""Corruptions of the family "illumination", which change V in HSV (paper, appendix "Illumination corruptions")."""
