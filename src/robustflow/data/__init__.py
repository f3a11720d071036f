"""Data sets, benchmarks and video."""
