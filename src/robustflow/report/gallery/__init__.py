"""Galleries of corruptions, as a figure or as an HTML page."""
