"""Evaluate networks in float64 that create or convert tensors in float32."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_map


def in_float64(net: nn.Module) -> Callable[..., Any]:
    """Return a function that calls a network with parameters in float64, and computes everything in float64."""

    def call(*images: Tensor, **arguments: Any) -> Any:
        with _Doubled():
            return net(*images, **arguments)

    return call


class _Doubled(TorchFunctionMode):
    """Replace float32 by float64 in the arguments and results of PyTorch's functions, in this thread."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        args, kwargs = tree_map(_doubled, (args, kwargs or {}))
        return _doubled((Tensor.double if func is Tensor.float else func)(*args, **kwargs))


def _doubled(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.double() if value.dtype == torch.float32 else value
    return torch.float64 if value is torch.float32 else value
