"""The registered models: their names, and the locations of their classes or functions that load them."""

from __future__ import annotations

from collections.abc import Callable

from ..core.plugins import Registry
from .networks.loaders import NETWORKS
from .protocols import AnyModel

MODELS: Registry[Callable[..., AnyModel]] = Registry("model", entry_point_group="robustflow.models", separator=" ")
MODELS.add("farneback", "robustflow.models.opencv:Farneback")
MODELS.add("dis", "robustflow.models.opencv:Dis")
MODELS.add("dis_rgb", "robustflow.models.dis.dis_rgb:DisRgb")
MODELS.add("precomputed", "robustflow.models.precomputed:Precomputed")
for _name in ("tiny", "tiny_no_weather", "tiny_all"):
    MODELS.add(_name, f"robustflow.models.tiny.tiny:{_name}")
for _name in NETWORKS:
    MODELS.add(_name, f"robustflow.models.networks.loaders:{_name}")
for _name in (
    *("raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer", "flowformer_pp"),
    *("videoflow_bof", "videoflow_mof", "memflow", "memflow_t", "streamflow", "memfof"),
):
    MODELS.add(_name, f"robustflow.models.ptlflow.loaders:{_name}")
MODELS.add("raft_large", "robustflow.models.torch.torchvision:raft_large")
MODELS.add("raft_small", "robustflow.models.torch.torchvision:raft_small")
MODELS.add("onnx", "robustflow.models.onnx:OnnxModel")
