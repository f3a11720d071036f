"""Errors of DIS under a corruption: on the demonstration pair, or on a short clip made from it for clip corruptions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import numpy as np

from robustflow import corrupt, load_dataset, load_model
from robustflow.corruptions import SEVERITIES, load_corruption
from robustflow.corruptions.registry import CLIP
from robustflow.data.benchmarks.paper import DEMO_CLASSES
from robustflow.data.video.open_clip import mean_of_windows, rolling_frames
from robustflow.data.video.variants import ShortClip
from robustflow.report.gallery.ssim import Ssim

KEY = "motorcycle"
_FRAMES, _RATE = 64, Fraction(960)
_PAIR = (16, 48)
"""Number of frames between the clip frames that form the pair: 32, as in GoPro-FC."""
_STEP = (0.25, 0.125)
"""Motion of the view from frame to frame, right and down, in pixels."""
_SIZE = (240, 360)
_AROUND = {"object_motion_blur": mean_of_windows, "rolling_shutter": rolling_frames}


@dataclass(frozen=True)
class Seen:
    """One severity: the corrupted frame, DIS's flow on the pair, and its errors in pixels."""

    severity: int
    frame: Any
    index: int
    flow: Any
    ssim: float
    epe: float
    epe_clean: float
    rcre: float


class Numbers(NamedTuple):
    """DIS's end-point error in pixels under one corruption at each severity, and on the clean frames."""

    epe: tuple[float, ...]
    epe_clean: float


def seen(name: str) -> list[Seen]:
    """Compute all severities of one corruption."""
    clip = name in CLIP
    frames, truth, valid, clean = clean_pair(clip)
    similarity = [Ssim(frame) for frame in frames]
    as_demo = load_corruption(name, classes=DEMO_CLASSES)
    pairs = (
        _clip_pairs(name)
        if clip
        else (
            corrupt(*frames, as_demo, severity, key=KEY, depth=_depth() if as_demo.needs_depth else None)
            for severity in SEVERITIES
        )
    )
    cells = []
    for severity, pair in zip(SEVERITIES, pairs, strict=True):
        index = int(np.array_equal(pair[0], frames[0]) and not np.array_equal(pair[1], frames[1]))
        flow = _model().predict(*pair)
        errors = (_distance(flow, truth, valid), _distance(clean, truth, valid), _distance(flow, clean, valid))
        cells.append(Seen(severity, pair[index], index, flow, similarity[index](pair[index]), *errors))
    return cells


@cache
def clean_pair(clip: bool) -> tuple[Any, Any, Any, Any]:
    """Frames, ground-truth flow (if known), and DIS's flow."""
    if clip:
        frames = tuple(_view(number) for number in _PAIR)
        moved = [-(_PAIR[1] - _PAIR[0]) * step for step in _STEP]
        truth, valid = np.full((*_SIZE, 2), moved, np.float32), np.ones(_SIZE, bool)
    else:
        sample = load_dataset(KEY).load(KEY)
        frames, truth, valid = sample.frames, sample.flow, sample.valid
    return frames, truth, valid, _model().predict(*frames)


@cache
def _depth() -> Any:
    """Make the pictures of the demonstration pair."""
    data = load_dataset(KEY)
    return data.depth(data.load(KEY))


@cache
def _model() -> Any:
    return load_model("dis")


def _distance(flow: Any, other: Any, valid: Any) -> float:
    return float(np.linalg.norm((flow - other).astype(np.float64), axis=2)[valid].mean())


@cache
def _photograph() -> Any:
    return load_dataset(KEY).load(KEY).frames[0]


@cache
def _view(number: int) -> Any:
    """Frame `number` of the clip, cut from a window that moves over the photograph."""
    right, down = (8 + number * step for step in _STEP)
    move = np.float32([[1, 0, -right], [0, 1, -down]])
    return cv2.warpAffine(_photograph(), move, _SIZE[::-1], flags=cv2.INTER_CUBIC)


def _clip_pairs(name: str) -> Iterator[tuple[Any, Any]]:
    parameters = [load_corruption(name).parameter(severity) for severity in SEVERITIES]
    if name in _AROUND:
        first, second = (_AROUND[name](_view, centre, parameters) for centre in _PAIR)
        yield from ((first[parameter], second[parameter]) for parameter in parameters)
        return
    wanted = range(_PAIR[0], _PAIR[1] + 1)
    with TemporaryDirectory() as folder:
        clip = ShortClip((_view(number) for number in range(_FRAMES)), _RATE, Path(folder))
        for parameter in parameters:
            frames, _ = clip.corrupted(name, parameter, wanted)
            yield frames[0], frames[-1]
