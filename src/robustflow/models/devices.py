"""Find the accelerators on which a model runs, from its attribute `device`: a string or a `torch.device`."""

from __future__ import annotations

import sys
from typing import Any

from ..errors import UsageError
from .loading import ModelSpec


def device_of(model: Any) -> str:
    """Return the device of a model ("cuda:0", "cuda", ...); "cpu" if it does not declare one."""
    device = getattr(model, "device", None)
    if isinstance(device, str):
        return device.strip() or "cpu"
    return str(device) if isinstance(getattr(device, "type", None), str) else "cpu"


def is_accelerator(device: str) -> bool:
    """Return whether a device is not the CPU.

    >>> is_accelerator("cuda:0"), is_accelerator("cpu")
    (True, False)
    """
    return device.partition(":")[0] not in ("cpu", "auto", "meta")


def devices_of(spec: ModelSpec | None, model: Any) -> tuple[str, ...]:
    """Return the accelerators that a run uses, each with its own prediction process; none for a model on the CPU."""
    listed = spec.devices() if spec is not None else ()
    if len(listed) > 1:
        if not all(is_accelerator(device) for device in listed):
            raise UsageError(f"--device {','.join(listed)}: only GPUs can be listed; pass cpu alone, with --workers")
        return listed
    own = device_of(model)
    if not is_accelerator(own):
        return ()
    if spec is not None and ":" not in own and (listed or not spec.is_own):
        return tuple(f"{own}:{number}" for number in range(_visible(own))) or (own,)
    return (own,)


def _visible(kind: str) -> int:
    """Return the number of devices of one kind that PyTorch finds, or 0 if it cannot determine the number or the model
    does not use PyTorch.
    """
    torch = sys.modules.get("torch")
    return int(torch.cuda.device_count()) if torch is not None and kind == "cuda" else 0
