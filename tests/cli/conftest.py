"""Two finished runs for commands to read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.api import evaluate


@pytest.fixture(scope="session")
def runs(tmp_path_factory) -> list[Path]:
    """The folders of two runs on the embedded pair, by DIS and by Farneback's method; the tests only read them."""
    folder = tmp_path_factory.mktemp("runs")
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
