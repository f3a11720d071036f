"""The gradient of a network through its `detach` calls.

Iterative networks detach the flow between iterations, which training needs. An attack that differentiates such a
network as it is written follows a different function than the one that predicts.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import SimpleNamespace
from typing import Any

import torch
import torch.utils.checkpoint as checkpointing
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

_AS_WRITTEN = ContextVar("networks are differentiated as written", default=False)
_CUTS = (Tensor.detach, torch.detach, Tensor.detach_, torch.detach_, Tensor.requires_grad_)
_LEAVING = (Tensor.numpy, Tensor.__array__, Tensor.__deepcopy__)
"""Functions that refuse a tensor with a gradient, which networks therefore detach first."""
_LOCK = threading.RLock()


@contextmanager
def as_written() -> Iterator[None]:
    """Differentiate networks as they are written within a `with` block, in this thread."""
    token = _AS_WRITTEN.set(True)
    try:
        yield
    finally:
        _AS_WRITTEN.reset(token)


def differentiated(net: nn.Module, call: Callable[[], Tensor]) -> Tensor:
    """Return the flow of a call of the network, with the whole gradient unless inside `as_written`.

    Tensors that the network keeps for its next call are detached afterwards.
    """
    if _AS_WRITTEN.get() or not torch.is_grad_enabled():
        return call()
    with _without_checkpointing(), _Undetached():
        flow = call()
    for module in net.modules():
        _detached(vars(module))
    return flow


class _Undetached(TorchFunctionMode):
    """Return the tensor itself from `detach` and `.data`, in this thread."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        tensor = args[0] if args else None
        if isinstance(tensor, Tensor) and tensor.requires_grad and not isinstance(tensor, nn.Parameter):
            getter = getattr(func, "__self__", None) is Tensor.data and func.__name__ == "__get__"
            if func in _CUTS or getter:
                return tensor
            if func in _LEAVING:
                args = (tensor.detach(), *args[1:])
        return func(*args, **(kwargs or {}))


@contextmanager
def _without_checkpointing() -> Iterator[None]:
    """Keep all activations: checkpointed parts would be computed again in the backward pass, with their `detach`."""

    def direct(*_: Any, **__: Any) -> Iterator[None]:
        yield

    names = [name for name in vars(checkpointing) if name.startswith("_checkpoint_without_reentrant_generator")]
    replaced: dict[str, Any] = dict.fromkeys(names, direct)
    replaced["CheckpointFunction"] = SimpleNamespace(apply=lambda function, _, *inputs: function(*inputs))
    with _LOCK:  # other threads keep their activations too, which does not change their results
        before = {name: getattr(checkpointing, name) for name in replaced}
        vars(checkpointing).update(replaced)
        try:
            yield
        finally:
            vars(checkpointing).update(before)


def _detached(kept: Any) -> Any:
    """Detach the tensors in attributes of a module, also in lists, tuples and dicts, in place where possible."""
    if isinstance(kept, Tensor):
        return kept if kept.grad_fn is None else kept.detach()
    if isinstance(kept, dict):
        kept.update({name: new for name, old in kept.items() if (new := _detached(old)) is not old})
    elif isinstance(kept, list):
        kept[:] = map(_detached, kept)
    elif isinstance(kept, tuple) and any(new is not old for new, old in zip(map(_detached, kept), kept, strict=True)):
        return type(kept)(*map(_detached, kept)) if hasattr(kept, "_fields") else tuple(map(_detached, kept))
    return kept
