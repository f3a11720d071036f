"""Corruptions of the family "sensor", caused by the camera between the scene and the file."""
