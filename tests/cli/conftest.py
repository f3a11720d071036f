"""The demo pair at a ninth of its pixels for all commands run in this process, and two finished runs to read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage

from robustflow.api import evaluate

WHOLE_DEMO = skimage.__file__
"""The value of `skimage.__file__` that gives the demo pair at its size, for which the documentation prints numbers."""


@pytest.fixture(scope="package", autouse=True)
def _small_demo(small_demo: str) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(skimage, "__file__", small_demo)
        yield


@pytest.fixture(scope="package")
def runs(tmp_path_factory, _small_demo: None) -> list[Path]:
    """The folders of two runs on the embedded pair, by DIS and by Farneback's method; the tests only read them."""
    return two_runs(tmp_path_factory.mktemp("runs"))


def two_runs(folder: Path) -> list[Path]:
    options = {"corruptions": ["contrast"], "severities": [1, 5]}
    return [evaluate(model, "demo", output=folder / model, **options).path for model in ("dis", "farneback")]


def write_frames(folder: Path, sizes=((64, 96), (64, 96))) -> list[Path]:
    """Write noise images 000.png, 001.png, ... with the given sizes (height, width); return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    paths = []
    for index, size in enumerate(sizes):
        paths.append(folder / f"{index:03d}.png")
        cv2.imwrite(str(paths[-1]), rng.integers(0, 255, (*size, 3)).astype(np.uint8))
    return paths
