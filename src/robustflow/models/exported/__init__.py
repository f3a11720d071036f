"""Exported networks as flow models: ONNX and torch.export."""
