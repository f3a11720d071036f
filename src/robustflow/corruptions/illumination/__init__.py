"""Illumination corruptions: a change of V in HSV (paper, appendix "Illumination corruptions")."""
