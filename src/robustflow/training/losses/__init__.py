"""The losses of the recipes, with and without labels, as functions of flows and images."""
