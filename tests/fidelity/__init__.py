"""Comparison with the outputs of the reference implementation."""
