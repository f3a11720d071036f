"""Corruptions by the sensor: what a camera adds between the scene and the file."""
