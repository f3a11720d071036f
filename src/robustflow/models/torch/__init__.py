"""PyTorch networks as flow models: adapter, checkpoints, torchvision."""
