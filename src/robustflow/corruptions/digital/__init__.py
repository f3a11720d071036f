"""The "digital" family of corruptions (paper, appendix "Digital corruptions")."""
