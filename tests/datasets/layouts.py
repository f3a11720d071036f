"""Small folders in the layouts of the real datasets; every file has different content."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.datasets import Dataset, load_dataset
from robustflow.errors import DataError
from robustflow.flowio import read_flow, write_flow
from robustflow.images.io import read_image

HEIGHT, WIDTH = 6, 8


def _digest(path: Path) -> np.ndarray:
    return np.frombuffer(hashlib.blake2b(path.as_posix().encode()).digest(), np.uint8)


def picture(path: Path, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Write an image whose content depends on its path; return it as RGB."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.resize(_digest(path), (height, width, 3))
    assert cv2.imwrite(str(path), image[..., ::-1])
    return image


def flow(path: Path, valid: np.ndarray | None = None, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Write a flow whose values depend on its path; return the flow."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.resize(_digest(path).astype(np.float32) / 4 - 32, (height, width, 2))
    write_flow(path, values, valid)
    return values


def mask(path: Path, values: np.ndarray) -> None:
    """Write a black-and-white image."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), values.astype(np.uint8) * 255)


def kitti(folder: Path, keys: list[str], images: str = "image_2", noc: bool = True, occ: bool = True) -> None:
    """Write pairs in KITTI's layout, with the first column occluded and the last row unknown."""
    known = np.ones((HEIGHT, WIDTH), bool)
    known[-1] = False
    visible = known.copy()
    visible[:, 0] = False
    for key in keys:
        picture(folder / images / f"{key}_10.png")
        picture(folder / images / f"{key}_11.png")
        if occ:
            flow(folder / "flow_occ" / f"{key}_10.png", known)
        if noc:
            flow(folder / "flow_noc" / f"{key}_10.png", visible)


def refused(name: str, root: Path, match: str, **options: object) -> None:
    with pytest.raises(DataError, match=match) as caught:
        load_dataset(name, root, **options)
    assert "\n" not in str(caught.value)


def check(dataset: Dataset, key: str, first: Path, second: Path, truth: Path | None) -> None:
    """Assert that the sample has exactly the contents of these files and lists them."""
    sample = dataset.load(key)
    np.testing.assert_array_equal(sample.frames[0], read_image(first))
    np.testing.assert_array_equal(sample.frames[1], read_image(second))
    assert dataset.files(key)[:2] == [first, second]
    assert dataset.has_flow == (truth is not None)
    if truth is not None:
        np.testing.assert_array_equal(sample.flow, read_flow(truth)[0])
        np.testing.assert_array_equal(sample.valid, read_flow(truth)[1])
        assert truth in dataset.files(key)
