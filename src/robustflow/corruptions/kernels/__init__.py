"""Compiled loops and filters that corruptions share."""
