"""Galleries of corruptions as pictures, a figure, or an HTML page."""
