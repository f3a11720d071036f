"""Corruptions of the family "digital" (paper, appendix "Digital corruptions")."""
