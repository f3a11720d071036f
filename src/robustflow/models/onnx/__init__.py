"""Optical-flow networks in ONNX files."""

from .model import OnnxModel

__all__ = ["OnnxModel"]
