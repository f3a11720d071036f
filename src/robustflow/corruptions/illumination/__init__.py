"""The "illumination" family of corruptions: changes of V in HSV (paper, appendix "Illumination corruptions")."""
