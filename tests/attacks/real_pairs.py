"""Crops of real pairs, and networks with trained weights."""

from functools import cache

import numpy as np

import robustflow as rf

from ..shared_data import shared_folder

_CORNERS = [
    *(("000010", 190, 300), ("000002", 200, 500), ("000010", 250, 700), ("000002", 200, 100), ("000003", 200, 600)),
    *(("000010", 250, 100), ("000003", 180, 200), ("000002", 200, 650), ("000003", 240, 350), ("000010", 200, 950)),
]


@cache
def _sample(key):
    return rf.load_dataset("kitti2015", shared_folder("data", "kitti2015"))[key]


def crop(number: int, size: tuple[int, int] = (64, 96)):
    """Return one of ten crops from KITTI 2015: its frames, flow and mask."""
    key, top, left = _CORNERS[number]
    sample, where = _sample(key), np.s_[top : top + size[0], left : left + size[1]]
    first, second = (np.ascontiguousarray(frame[where]) for frame in sample.frames)
    return (first, second), sample.flow[where].copy(), sample.valid[where].copy()


@cache
def trained(name: str):
    """Load `tiny`, or a network whose weights are part of the shared data."""
    options = {} if name == "tiny" else {"checkpoint": shared_folder("weights", f"{name}.pth")}
    return rf.load_model(name, device="cpu", **options)
