"""Severities that are comparable between corruptions: the search for them and the shipped scale."""
