"""Galleries of corruptions: a figure or an HTML page."""
