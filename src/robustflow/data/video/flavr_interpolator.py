"""Wrap FLAVR as an interpolator of uint8 frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import UsageError
from ...core.files import sha256_of_file
from ...core.types import Frame

MULTIPLE = 8
"""Height and width must be multiples of this number; other sizes are padded by repeating the border, and cropped
again.
"""


class FlavrInterpolator:
    """The interpolator "flavr", 4x (Kalluri et al., WACV 2023; used in the paper). Requires the extra `torch`."""

    name = "flavr"

    def __init__(self, checkpoint: Path, device: str = "cpu") -> None:
        from .flavr import load_flavr

        self._model: Any = load_flavr(checkpoint, device)
        self._device = device
        self._sha256 = sha256_of_file(checkpoint)

    def between(self, window: Sequence[Frame], factor: int) -> list[Frame]:
        """Return the three frames between the middle two frames of the window."""
        if factor != 4:
            raise UsageError(
                f"FLAVR's 4x weights do not support a factor of {factor}: use --factor 4 or --interpolator flow"
            )
        import torch

        height, width = window[0].shape[:2]
        pad = ((0, -height % MULTIPLE), (0, -width % MULTIPLE), (0, 0))
        tensors = [
            torch.from_numpy(np.pad(frame, pad, mode="edge")).permute(2, 0, 1)[None].to(self._device).float() / 255
            for frame in window
        ]
        with torch.inference_mode():
            outputs = self._model(tensors)
        return [self._frame(output)[:height, :width] for output in outputs]

    def describe(self) -> dict[str, Any]:
        """Return the method, checkpoint hash, versions and device."""
        import torch

        return {
            "name": self.name,
            "checkpoint_sha256": self._sha256,
            "torch": torch.__version__,
            "device": self._device,
        }

    @staticmethod
    def _frame(output: Any) -> Frame:
        scaled = (output[0] * 255).clamp(0, 255).round().permute(1, 2, 0)
        return np.ascontiguousarray(scaled.to("cpu").numpy().astype(np.uint8))
