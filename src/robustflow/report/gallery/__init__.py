"""Corruptions to look at: pictures, a figure, a page."""
