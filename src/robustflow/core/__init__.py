"""Foundations that every room uses."""
