"""The accelerators that a model computes on, as it declares: an attribute `device`, a string or one of PyTorch's."""

from __future__ import annotations

import sys
from typing import Any

from ..errors import UsageError
from .loading import ModelSpec


def device_of(model: Any) -> str:
    """Where a model computes: "cuda:0", "cuda", ...; "cpu" if it does not say.

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
    """Whether a device is not the processor.

    >>> is_accelerator("cuda:0"), is_accelerator("cpu")
    (True, False)
    """
    return device.partition(":")[0] not in ("cpu", "auto", "meta")


def devices_of(spec: ModelSpec | None, model: Any) -> tuple[str, ...]:
    """The accelerators that a run of a model uses, one predicting process each; none for a model on the CPU.

    Those that the option `device` lists ("cuda:0,cuda:1"); every one that PyTorch finds if it is "cuda", or is left out
    for one of this package's networks; otherwise the one that the loaded model declares.

    Args:
        spec: how to load the model again; None for an object.
        model: loaded.

    Raises:
        UsageError: a list of devices that includes the processor.
    """
    listed = spec.devices() if spec is not None else ()
    if len(listed) > 1:
        if not all(is_accelerator(device) for device in listed):
            raise UsageError(f"--device {','.join(listed)}: only GPUs can be listed; give cpu by itself, and --workers")
        return listed
    own = device_of(model)
    if not is_accelerator(own):
        return ()
    if spec is not None and ":" not in own and (listed or not spec.is_own):
        return tuple(f"{own}:{number}" for number in range(_visible(own))) or (own,)
    return (own,)


def _visible(kind: str) -> int:
    """How many devices of a kind PyTorch finds; 0 if it does not say, or if the model does not use PyTorch."""
    torch = sys.modules.get("torch")
    return int(torch.cuda.device_count()) if torch is not None and kind == "cuda" else 0
