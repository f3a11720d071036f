"""Run a network reproducibly."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

# Since PyTorch 2.9, precision is set per backend; the older functions, needed before 2.9, cannot report these settings.
_PER_BACKEND = hasattr(torch.backends.cuda.matmul, "fp32_precision")
_MATMULS: tuple[Any, ...] = (torch.backends.cuda.matmul, torch.backends.mkldnn.matmul) if _PER_BACKEND else ()
_IEEE: dict[str, Any] = {"fp32_precision": "ieee"} if _PER_BACKEND else {}


@contextmanager
def reproducible(threads: int = 1) -> Iterator[None]:
    """Run a block with true float32 (no TF32), deterministic algorithms and a fixed number of CPU threads, then restore
    the previous settings.
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
    except RuntimeError:  # the precision was set per backend, and is restored in the same way
        return "highest"
