"""Corruptions of the family "depth": 3D versions of the paper's weather and optics, based on scene depth."""
