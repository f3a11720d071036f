"""Losses of the recipes, as functions of flows and images: with labels and without."""
