"""Corruptions of the family "weather": spatter, fog, frost and snow."""
