"""Exported networks as flow models: ONNX, torch.export, TorchScript."""
