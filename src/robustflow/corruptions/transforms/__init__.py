"""Use corruptions as augmentations in a training pipeline."""
