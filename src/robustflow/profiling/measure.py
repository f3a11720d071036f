"""Measure the time and memory of actual predictions."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass

import numpy as np
import torch

from ..errors import UsageError
from ..models.tiling import TiledModel
from ..models.torch.model import NetworkModel


@dataclass(frozen=True)
class PredictionCost:
    """Measurements from several predictions."""

    seconds: float
    peak_bytes: int
    device: str


def measure_prediction(model: NetworkModel | TiledModel, height: int, width: int, repeat: int = 1) -> PredictionCost:
    """Time predictions on a pair of random frames; on a GPU, one additional warm-up prediction is made first."""
    if repeat < 1:
        raise UsageError(f"the number of repetitions must be at least 1, not {repeat}")
    frames = np.random.default_rng(0).integers(0, 256, (2, height, width, 3)).astype(np.uint8)
    gpu = model.device.type == "cuda"
    if gpu:
        model.predict(*frames)
        torch.cuda.reset_peak_memory_stats(model.device)
    seconds = []
    for _ in range(repeat):
        start = time.perf_counter()
        model.predict(*frames)  # waits for the GPU, because the flow is copied to the CPU
        seconds.append(time.perf_counter() - start)
    unit = 1 if sys.platform == "darwin" else 1024
    peak = torch.cuda.max_memory_allocated(model.device) if gpu else 0
    peak = peak or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return PredictionCost(min(seconds), peak, str(model.device))
