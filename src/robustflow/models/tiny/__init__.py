"""The project's own small network without PyTorch: NumPy's matrix product, and compiled loops for the rest."""
