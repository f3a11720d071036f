"""The device of a loaded model, and the accelerators that a run uses."""

from __future__ import annotations

import sys
from typing import Any

from ..core.errors import UsageError
from .loading import ModelRef


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


def devices_of(ref: ModelRef | None, model: Any) -> tuple[str, ...]:
    """Return the accelerators that a run uses, each with its own prediction process; none for a model on the CPU."""
    listed = ref.devices() if ref is not None else ()
    if len(listed) > 1:
        if not all(is_accelerator(device) for device in listed):
            raise UsageError("--device", f"only GPUs can be listed, not {','.join(listed)}; pass cpu alone")
        return listed
    own = device_of(model)
    if not is_accelerator(own):
        return ()
    if ref is not None and ":" not in own and (listed or not ref.is_own):
        return tuple(f"{own}:{number}" for number in range(_visible(own))) or (own,)
    return (own,)


def _visible(kind: str) -> int:
    """Return the number of devices of one kind that PyTorch finds; 0 if the model does not use PyTorch."""
    torch = sys.modules.get("torch")
    return int(torch.cuda.device_count()) if torch is not None and kind == "cuda" else 0
