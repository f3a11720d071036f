"""Lenses at build time: prescriptions, ray tracing, and the search that designs them."""
