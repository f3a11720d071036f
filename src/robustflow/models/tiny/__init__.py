"""The project's small network without PyTorch: NumPy's matrix product, and compiled loops for the rest."""
