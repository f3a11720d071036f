"""One OpenMP thread per process, and one way to find the shared real data."""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2
import hypothesis
import pytest

from .shared_data import shared_folder

cv2.setNumThreads(1)
hypothesis.settings.register_profile("untimed", deadline=None)  # a busy machine is no failure
hypothesis.settings.load_profile("untimed")


@pytest.fixture
def shared():
    """Find a folder of the shared data: `shared("data/kitti2015")`; skips, with the reason, where it is absent."""
    return shared_folder
