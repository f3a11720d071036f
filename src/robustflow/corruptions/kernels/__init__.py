"""Compiled loops and filters that corruptions are made of."""
