"""Severities that are comparable between corruptions: the search for them and the scale that ships."""
