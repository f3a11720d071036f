"""Which accelerators a model computes on, as it says itself: an attribute `device`, a text or one of PyTorch's."""

from __future__ import annotations

import sys
from typing import Any

from ..errors import UsageError
from .loading import ModelSpec


def device_of(model: Any) -> str:
    """Where a model computes: "cuda:0", "cuda", ...; "cpu" where it does not say.

    >>> class Mine:
    ...     device = "cuda:1"
    >>> device_of(Mine()), device_of(object())
    ('cuda:1', 'cpu')
    """
    device = getattr(model, "device", None)
    if isinstance(device, str):
        return device.strip() or "cpu"
    return str(device) if isinstance(getattr(device, "type", None), str) else "cpu"


def is_accelerator(device: str) -> bool:
    """Whether a device is another than the processor.

    >>> is_accelerator("cuda:0"), is_accelerator("cpu")
    (True, False)
    """
    return device.partition(":")[0] not in ("cpu", "auto", "meta")


def devices_of(spec: ModelSpec | None, model: Any) -> tuple[str, ...]:
    """The accelerators that a run of a model uses, one predicting process each; none for a model on the CPU.

    Those that the option `device` lists ("cuda:0,cuda:1"); every one that PyTorch sees where it is "cuda", or left out
    of one of this package's networks; else the one that the loaded model says.

    Args:
        spec: how to load the model again; None for an object.
        model: loaded.

    Raises:
        UsageError: a list of devices with the processor among them.
    """
    listed = spec.devices() if spec is not None else ()
    if len(listed) > 1:
        if not all(is_accelerator(device) for device in listed):
            raise UsageError(f"--device {','.join(listed)}: a list is of GPUs; give cpu alone, and --workers")
        return listed
    own = device_of(model)
    if not is_accelerator(own):
        return ()
    if spec is not None and ":" not in own and (listed or not spec.is_own):
        return tuple(f"{own}:{number}" for number in range(_visible(own))) or (own,)
    return (own,)


def _visible(kind: str) -> int:
    """How many devices of a kind PyTorch sees; 0 where it does not say, or is not what the model uses."""
    torch = sys.modules.get("torch")
    return int(torch.cuda.device_count()) if torch is not None and kind == "cuda" else 0
