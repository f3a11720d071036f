"""Lens design at build time, and the space-variant blur of a lens at run time."""
