"""A file with a flipped bit is read, or refused with an error that names it."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from robustflow.attacks.trained import read_array as read_perturbation
from robustflow.core.errors import DataError
from robustflow.data.datasets.motorcycle import Motorcycle
from robustflow.media.depth import read_camera, read_depth_npy, read_depth_pfm, read_depth_png, read_dpt, read_dsp5
from robustflow.media.flow import FLOW_SUFFIXES, read_flow, write_flow
from robustflow.media.images import read_image

FLIPS = 200
FLOW = np.linspace(-3, 4, 4 * 5 * 2, dtype=np.float32).reshape(4, 5, 2)
DEPTH = np.linspace(1, 80, 4 * 5, dtype=np.float32).reshape(4, 5)


def read_motorcycle(path: Path) -> Any:
    dataset = Motorcycle()
    dataset._files = (*dataset._files[:2], path)
    return dataset._truth()


def write_dsp5(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["disparity"] = DEPTH


def write_dpt(path: Path) -> None:
    path.write_bytes(np.float32(202021.25).tobytes() + np.int32([5, 4]).tobytes() + DEPTH.tobytes())


def write_flow_file(path: Path) -> None:
    if path.suffix == ".flo5":
        pytest.importorskip("h5py")
    write_flow(path, FLOW)


def write_picture(path: Path) -> None:
    Image.fromarray((np.arange(12 * 17 * 3).reshape(12, 17, 3) * 37 % 251).astype(np.uint8)).save(path)


CASES: dict[str, tuple[str, Callable[[Path], Any], Callable[[Path], Any]]] = {
    **{f"flow{suffix}": (f"flow{suffix}", write_flow_file, read_flow) for suffix in FLOW_SUFFIXES},
    **{f"image.{kind}": (f"image.{kind}", write_picture, read_image) for kind in ("png", "jpeg", "tiff", "webp")},
    "depth.npy": ("depth.npy", lambda path: np.save(path, DEPTH), read_depth_npy),
    "depth.png": ("depth.png", lambda path: cv2.imwrite(str(path), DEPTH.astype(np.uint16)), read_depth_png),
    "depth.pfm": ("depth.pfm", lambda path: path.write_bytes(b"Pf\n5 4\n-1.0\n" + DEPTH.tobytes()), read_depth_pfm),
    "depth.dpt": ("depth.dpt", write_dpt, read_dpt),
    "depth.dsp5": ("depth.dsp5", write_dsp5, read_dsp5),
    "camera.cam": (
        "camera.cam",
        lambda path: path.write_bytes(np.float32(202021.25).tobytes() + np.ones(21).tobytes()),
        read_camera,
    ),
    "perturbation.npy": (
        "perturbation.npy",
        lambda path: np.save(path, np.zeros((3, 4, 5), np.float32)),
        lambda path: read_perturbation(str(path)),
    ),
    "motorcycle.npz": ("motorcycle.npz", lambda path: np.savez_compressed(path, DEPTH), read_motorcycle),
}


@pytest.mark.parametrize("case", CASES)
def test_flipped_bit_in_a_file_is_refused_with_its_path_or_read(tmp_path: Path, case: str) -> None:
    name, write, read = CASES[case]
    path = tmp_path / name
    write(path)
    whole, expected = path.read_bytes(), read(path)
    draw = random.Random(case)
    errors = []
    for _ in range(FLIPS):
        at = draw.randrange(min(len(whole), 2000))
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << draw.randrange(8)]) + whole[at + 1 :])
        try:
            changed = read(path)
        except DataError as error:
            errors.append(str(error))
            continue
        if path.suffix == ".png":  # its checksums leave no other value
            assert all(map(np.array_equal, changed, expected))
    assert errors
    assert all(str(path) in error for error in errors)
