"""Corruptions as augmentation in a training pipeline."""
