"""The "sensor" family of corruptions: noise and processing inside the camera."""
