"""Digital corruptions (paper, appendix "Digital corruptions")."""
