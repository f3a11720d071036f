"""The project's small network without PyTorch: NumPy matrix products and compiled loops."""
