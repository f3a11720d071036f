"""Spatter, fog, frost and snow."""
