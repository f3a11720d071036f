"""The registered models: their names, and the locations of their classes or factories."""

from __future__ import annotations

from collections.abc import Callable

from ..core.plugins import Registry
from .base import AnyModel
from .networks.table import NETWORKS

MODELS: Registry[Callable[..., AnyModel]] = Registry("model", entry_point_group="robustflow.models", separator=" ")
MODELS.add("farneback", "robustflow.models.opencv:Farneback")
MODELS.add("dis", "robustflow.models.opencv:Dis")
MODELS.add("dis_rgb", "robustflow.models.dis.model:DisRgb")
MODELS.add("precomputed", "robustflow.models.precomputed:Precomputed")
for _name in ("tiny", "tiny_no_weather", "tiny_all"):
    MODELS.add(_name, f"robustflow.models.tiny.model:{_name}")
for _name in NETWORKS:
    MODELS.add(_name, f"robustflow.models.networks.table:{_name}")
for _name in (
    *("raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer", "flowformer_pp"),
    *("videoflow_bof", "videoflow_mof", "memflow", "memflow_t", "streamflow", "memfof"),
):
    MODELS.add(_name, f"robustflow.models.ptlflow.models:{_name}")
MODELS.add("raft_large", "robustflow.models.torch.torchvision:raft_large")
MODELS.add("raft_small", "robustflow.models.torch.torchvision:raft_small")
MODELS.add("onnx", "robustflow.models.onnx:OnnxModel")

EXPORTED = {".onnx": "onnx"}
"""File extensions of exported networks, with the model that reads each of them."""

TORCHSCRIPT = (".ts", ".torchscript")
"""Extensions of TorchScript, which is not supported: PyTorch's reader runs code from the file before any check."""
