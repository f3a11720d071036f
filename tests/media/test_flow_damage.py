"""Files that are truncated, claim a wrong size, or have a different format are rejected with a one-line message before
memory is allocated.
"""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.media.flow import FLOW_SUFFIXES, read_flow, write_flow
from tests import refusals

FLOW = np.linspace(-3, 4, 4 * 5 * 2, dtype=np.float32).reshape(4, 5, 2)


def refused(path: Path, match: str = ".") -> None:
    with refusals.refused(DataError, match) as caught:
        read_flow(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
def test_truncated_flow_files_are_refused(tmp_path: Path, suffix: str) -> None:
    if suffix == ".flo5":
        pytest.importorskip("h5py")
    path = tmp_path / f"flow{suffix}"
    write_flow(path, FLOW, np.eye(4, 5, dtype=bool))
    whole = path.read_bytes()
    cut = tmp_path / f"cut{suffix}"
    step = 37 if suffix == ".flo5" else 1  # an HDF5 file has thousands of bytes, most of them unused
    for length in [*range(0, len(whole), step), len(whole) - 1]:
        cut.write_bytes(whole[:length])
        refused(cut)


@pytest.mark.parametrize("suffix", [".flo", ".pfm"])
def test_flow_file_with_an_extra_byte_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"flow{suffix}"
    write_flow(path, FLOW)
    path.write_bytes(path.read_bytes() + b"\0")
    refused(path, "too long")


def test_a_flipped_byte_of_a_png_is_detected_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "flow.png"
    write_flow(path, FLOW)
    expected, _ = read_flow(path)
    whole = path.read_bytes()
    for position in range(len(whole)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x55]) + whole[position + 1 :])
        try:
            flow, _ = read_flow(path)
        except DataError:
            continue
        np.testing.assert_array_equal(flow, expected)


HOSTILE = {
    "huge.flo": b"PIEH" + struct.pack("<ii", 99999, 99999) + bytes(64),
    "negative.flo": b"PIEH" + struct.pack("<ii", -4, -5) + bytes(160),
    "zero.flo": b"PIEH" + struct.pack("<ii", 0, 7),
    "overflow.flo": b"PIEH" + struct.pack("<ii", 2**31 - 1, 2**31 - 1) + bytes(64),
    "magic.flo": b"PIEX" + struct.pack("<ii", 2, 2) + bytes(32),
    "big_endian.flo": b"HEIP" + struct.pack(">ii", 2, 2) + bytes(32),
    "huge.pfm": b"PF\n99999 99999\n-1.0\n" + bytes(64),
    "long.pfm": b"PF\n" + b"9" * 500,
    "zero.pfm": b"PF\n0 3\n-1.0\n",
    "scale0.pfm": b"PF\n1 1\n0\n" + bytes(12),
    "scale2.pfm": b"PF\n1 1\n-2.0\n" + bytes(12),
    "scale.pfm": b"PF\n1 1\n1e-e-\n" + bytes(12),
    "grey.pfm": b"Pf\n1 1\n-1.0\n" + bytes(4),
    "picture.pfm": b"P6\n1 1\n255\n" + bytes(3),
    "huge.png": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
    + struct.pack(">IIBBBBB", 90000, 90000, 16, 2, 0, 0, 0)
    + bytes(40)
    + b"\0\0\0\0IEND\xaeB`\x82",
    "text.png": b"<!DOCTYPE html><html></html>",
    "text.flo5": b"<!DOCTYPE html><html></html>",
    "empty.flo": b"",
    "empty.png": b"",
    "empty.pfm": b"",
    "empty.flo5": b"",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_headers_cost_no_memory(tmp_path: Path, name: str) -> None:
    if name.endswith(".flo5"):
        pytest.importorskip("h5py")
    (tmp_path / name).write_bytes(HOSTILE[name])
    tracemalloc.start()
    try:
        refused(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_damaged_flo5_files_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "flow.flo5"
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["flow"] = FLOW
    cases = {
        "stores": lambda file: file.create_dataset("flow", (8000, 8000, 2), "f4", chunks=(100, 100, 2)),
        "59049x59049": lambda file: file.create_dataset("flow", (9**5, 9**5, 2), "f4", chunks=(1, 1, 2)),
        "header claims 2": lambda file: file.create_dataset("flow", (2**31, 2, 2), "f4", chunks=(1, 1, 2)),
        "float \\(H, W, 2\\)": lambda file: file.create_dataset("flow", data=FLOW[..., 0]),
        "is float": lambda file: file.create_dataset("flow", data=FLOW.astype("i4")),
        "no dataset 'flow'": lambda file: file.create_dataset("disparity", data=FLOW),
        "plain dataset": lambda file: file.create_group("flow"),
        "HDF5 filters": lambda file: file.create_dataset("flow", data=FLOW, compression="lzf"),
        "inflates to more than its 160 bytes": lambda file: file.create_dataset(
            "flow", FLOW.shape, "f4", chunks=FLOW.shape, compression="gzip"
        ).id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(80_000_000))),
        "so it is not a Spring": lambda file: file.__setitem__("flow", h5py.ExternalLink(str(other), "flow")),
    }
    for match, write in cases.items():
        with h5py.File(path, "w") as file:
            write(file)
        refused(path, match)


@pytest.mark.parametrize(
    ("bits", "channels", "says"),
    [(8, 1, "8-bit PNG"), (8, 3, "8-bit PNG"), (8, 4, "8-bit PNG"), (16, 1, "16-bit PNG with 1 channel")],
)
def test_image_file_as_flow_is_refused(tmp_path: Path, bits: int, channels: int, says: str) -> None:
    cv2.imwrite(str(tmp_path / "picture.png"), np.zeros((4, 5, channels), f"u{bits // 8}"))
    refused(tmp_path / "picture.png", says)


def test_unknown_formats_folders_and_missing_flow_files_are_refused(tmp_path: Path) -> None:
    refused(tmp_path / "flow.tif", r"unknown flow format '\.tif'")
    (tmp_path / "folder.flo").mkdir()
    refused(tmp_path / "folder.flo", "not a file")
    refused(tmp_path / "missing.flo", "no such file; check the path")
