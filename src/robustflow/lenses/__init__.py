"""Lens design at build time: prescriptions, ray tracing and automated search."""
