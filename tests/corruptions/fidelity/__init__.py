"""Comparison with the output of the reference implementation."""
