"""Run a network so that it gives the same numbers again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

# PyTorch 2.9 sets precision per backend; the older functions, the only ones before it, cannot report such a setting.
_PER_BACKEND = hasattr(torch.backends.cuda.matmul, "fp32_precision")
_MATMULS: tuple[Any, ...] = (torch.backends.cuda.matmul, torch.backends.mkldnn.matmul) if _PER_BACKEND else ()
_IEEE: dict[str, Any] = {"fp32_precision": "ieee"} if _PER_BACKEND else {}


@contextmanager
def reproducible(threads: int = 1) -> Iterator[None]:
    """Run with true float32 (no TF32), the same algorithms every time and a fixed number of CPU threads. Earlier
    settings are restored afterwards.
    """
    before = torch.get_num_threads(), _matmul_precision(), [backend.fp32_precision for backend in _MATMULS]
    torch.set_num_threads(threads)
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False, **_IEEE):
            yield
    finally:
        torch.set_num_threads(before[0])
        torch.set_float32_matmul_precision(before[1])
        for backend, precision in zip(_MATMULS, before[2], strict=True):
            backend.fp32_precision = precision


def _matmul_precision() -> str:
    try:
        return torch.get_float32_matmul_precision()
    except RuntimeError:  # it was set per backend, and is restored there
        return "highest"
