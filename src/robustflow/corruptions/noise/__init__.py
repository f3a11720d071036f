"""The "noise" family of corruptions, independent in each frame (paper, appendix "Noise corruptions")."""
