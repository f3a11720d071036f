"""Optical-flow networks in ONNX files."""

from .process import OnnxModel

__all__ = ["OnnxModel"]
