"""Values written in any format are read back unchanged, an independent reader agrees, and damage is refused."""

from __future__ import annotations

import struct
import sys
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from robustflow.core.errors import AssetError, DataError
from robustflow.media.arrays import claimed_size
from robustflow.media.flow import FLOW_SUFFIXES, read_flow, write_flow
from tests.refusals import refusal

FLOW = np.linspace(-3, 4, 4 * 5 * 2, dtype=np.float32).reshape(4, 5, 2)
SHAPES = st.tuples(st.integers(1, 7), st.integers(1, 7))
quick = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)


def refused(path: Path) -> DataError:
    return refusal(lambda: read_flow(path), DataError, path)


def needs_h5py(name: str) -> None:
    if name.endswith(".flo5"):
        pytest.importorskip("h5py")


@st.composite
def flows(draw: st.DrawFn, limit: float, non_finite: bool = False) -> tuple[np.ndarray, np.ndarray]:
    shape = draw(SHAPES)
    numbers = st.floats(-limit, limit, width=32)
    if non_finite:
        numbers = numbers | st.sampled_from([np.nan, np.inf, -np.inf])
    return draw(hnp.arrays(np.float32, (*shape, 2), elements=numbers)), draw(hnp.arrays(np.bool_, shape))


@pytest.mark.parametrize("suffix", [".flo", ".pfm", ".flo5", ".npy"])
@given(data=flows(1e8, non_finite=True))
@quick
def test_float_formats_keep_every_bit(tmp_path: Path, suffix: str, data: tuple[np.ndarray, np.ndarray]) -> None:
    needs_h5py(suffix)
    flow, valid = data
    path = tmp_path / f"flow{suffix}"
    write_flow(path, flow, valid)
    read, known = read_flow(path)
    expected = valid & np.isfinite(flow).all(axis=2)
    assert (read.dtype, known.dtype) == (np.float32, np.bool_)
    np.testing.assert_array_equal(known, expected)
    np.testing.assert_array_equal(read, np.where(expected[..., None], flow, 0))
    assert list(tmp_path.iterdir()) == [path]


@given(data=flows(511.984375, non_finite=True))
@quick
def test_kitti_rounds_to_the_nearest_64th(tmp_path: Path, data: tuple[np.ndarray, np.ndarray]) -> None:
    flow, valid = data
    write_flow(tmp_path / "flow.png", flow, valid)
    read, known = read_flow(tmp_path / "flow.png")
    np.testing.assert_array_equal(known, valid & np.isfinite(flow).all(axis=2))
    assert (read[~known] == 0).all()
    assert (np.abs(read[known].astype(np.float64) - flow[known]) <= 1 / 128).all()
    np.testing.assert_array_equal(read * 64, np.rint(read * 64))


def test_kitti_holds_its_whole_range_exactly(tmp_path: Path) -> None:
    every = (np.arange(65536, dtype=np.float32) - 32768) / 64
    flow = np.stack([every, every[::-1]], axis=-1).reshape(256, 256, 2)
    write_flow(tmp_path / "flow.png", flow)
    read, valid = read_flow(tmp_path / "flow.png")
    assert valid.all()
    np.testing.assert_array_equal(read, flow)


@pytest.mark.parametrize("value", [512.0, -512.01, 511.9999])
def test_kitti_refuses_valid_vectors_beyond_its_range(tmp_path: Path, value: float) -> None:
    flow, path = np.zeros((2, 2, 2), np.float32), tmp_path / "flow.png"
    flow[1, 0, 1] = value
    refusal(lambda: write_flow(path, flow), DataError, path)
    assert list(tmp_path.iterdir()) == []
    write_flow(path, flow, np.array([[True, True], [False, True]]))
    assert read_flow(path)[1].sum() == 3


def test_kitti_encoding_equals_hand_computed_values(tmp_path: Path) -> None:
    """The development kit's formula, in OpenCV's BGR order; an EXIF orientation does not turn the map."""
    raw = np.zeros((1, 2, 3), np.uint16)
    raw[0, 0] = (1, 32768 - 64 * 3, 32768 + 32)  # valid, v = -3, u = 0.5
    raw[0, 1] = (0, 40000, 40000)
    path = tmp_path / "flow.png"
    cv2.imwrite(str(path), raw)
    exif = Image.Exif()
    exif[0x0112] = 3
    content = b"eXIf" + exif.tobytes().removeprefix(b"Exif\0\0")
    chunk = struct.pack(">I", len(content) - 4) + content + struct.pack(">I", zlib.crc32(content))
    whole = path.read_bytes()
    for data in (whole, whole[:33] + chunk + whole[33:]):
        path.write_bytes(data)
        flow, valid = read_flow(path)
        assert valid.tolist() == [[True, False]]
        assert flow.tolist() == [[[0.5, -3.0], [0.0, 0.0]]]


def channels(red: Any, green: Any, blue: Any, kind: type = np.uint16) -> np.ndarray:
    """A PNG's channels in OpenCV's order."""
    return np.dstack([np.broadcast_to(np.asarray(one), (4, 5)).astype(kind) for one in (blue, green, red)])


OTHER_PNGS = {
    "Virtual KITTI 2": channels(35000, 30000, 65535),
    "Virtual KITTI 2 with sky": channels(35000, 30000, np.where(np.eye(4, 5), 0, 65535)),
    "a mask of 255": channels(33000, 32000, 255),
    "the channels in reverse": channels(1, 32000, 33000),
    "a picture of flow in 16 bits": channels(65535, 30000, 2),
    "a picture of flow": channels(255, 128, 1, np.uint8),
    "a picture of flow with alpha": np.dstack([channels(255, 128, 1), np.full((4, 5), 1, np.uint16)]),
}


@pytest.mark.parametrize("case", OTHER_PNGS)
def test_png_of_another_data_set_is_refused(tmp_path: Path, case: str) -> None:
    assert cv2.imwrite(str(tmp_path / "flow.png"), OTHER_PNGS[case])
    refused(tmp_path / "flow.png")


@pytest.mark.parametrize(
    ("array", "first"),
    [
        (np.moveaxis(FLOW, 2, 0), -3.0),
        (np.asfortranarray(FLOW.astype(np.float64)), -3.0),
        (np.full((2, 3, 2), 7, np.int32), 7.0),
        *((wrong, None) for wrong in (FLOW[..., 0], FLOW[None], FLOW.repeat(2, axis=2), FLOW.astype(complex))),
        *((np.zeros((4, 5, 2), kind), None) for kind in (np.uint16, bool, object)),
    ],
)
def test_npy_is_read_with_the_components_first_or_last(tmp_path: Path, array: np.ndarray, first: float | None) -> None:
    np.save(tmp_path / "flow.npy", array)
    if first is None:
        refused(tmp_path / "flow.npy")
        return
    flow, valid = read_flow(tmp_path / "flow.npy")
    np.testing.assert_array_equal(flow, FLOW if first == -3 else array)
    assert (flow.dtype, flow.flags.c_contiguous, valid.all()) == (np.float32, True, True)


@given(data=flows(1e8))
@quick
def test_flo_and_pfm_agree_with_opencv(tmp_path: Path, data: tuple[np.ndarray, np.ndarray]) -> None:
    flow, _ = data
    write_flow(tmp_path / "ours.flo", flow)
    np.testing.assert_array_equal(cv2.readOpticalFlow(str(tmp_path / "ours.flo")), flow)
    cv2.writeOpticalFlow(str(tmp_path / "theirs.flo"), flow)
    np.testing.assert_array_equal(read_flow(tmp_path / "theirs.flo")[0], flow)
    write_flow(tmp_path / "flow.pfm", flow)
    by_opencv = cv2.imread(str(tmp_path / "flow.pfm"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(by_opencv[..., :0:-1], flow)


@pytest.mark.filterwarnings("error")
def test_masked_vectors_and_half_precision_are_written_as_such(tmp_path: Path) -> None:
    flow = np.ma.masked_greater(np.array([[[1, 2], [9, 2]]], np.float16), 5)
    write_flow(tmp_path / "flow.flo", flow)
    read, valid = read_flow(tmp_path / "flow.flo")
    assert (read.tolist(), valid.tolist()) == ([[[1, 2], [0, 0]]], [[True, False]])


def test_a_name_too_long_for_the_file_system_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / f"{'x' * 300}.flo")


def test_flo_marks_unknown_as_middlebury_does(tmp_path: Path) -> None:
    write_flow(tmp_path / "flow.flo", np.ones((1, 2, 2)), np.array([[True, False]]))
    stored = np.frombuffer((tmp_path / "flow.flo").read_bytes()[12:], "<f4")
    assert stored.tolist() == [1, 1, np.float32(1.6666667e9), np.float32(1.6666667e9)]


@pytest.mark.parametrize(("order", "scale"), [("<", b"-1.0"), (">", b"1.0"), (">", b"1"), ("<", b"-1.000000")])
def test_pfm_in_both_byte_orders_equals_hand_written_bytes(tmp_path: Path, order: str, scale: bytes) -> None:
    """Rows are stored from bottom to top, the third channel is ignored, and NaN and infinity mark unknown flow."""
    bottom, top = [1.5, -2, 7, np.nan, 0, 0], [3, 4, 9, 1, np.inf, 0]
    (tmp_path / "flow.pfm").write_bytes(b"PF\n2 2\n" + scale + b"\n" + struct.pack(f"{order}12f", *bottom, *top))
    flow, valid = read_flow(tmp_path / "flow.pfm")
    assert valid.tolist() == [[True, False], [True, False]]
    assert flow.tolist() == [[[3, 4], [0, 0]], [[1.5, -2], [0, 0]]]


def test_flo5_is_the_dataset_flow_with_nan(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    h5py = pytest.importorskip("h5py")
    write_flow(tmp_path / "flow.flo5", np.ones((2, 3, 2)), np.eye(2, 3, dtype=bool))
    with h5py.File(tmp_path / "flow.flo5") as file:
        stored = file["flow"][()]
    np.testing.assert_array_equal(np.isfinite(stored).all(axis=2), np.eye(2, 3, dtype=bool))
    with h5py.File(tmp_path / "double.flo5", "w") as file:
        file["flow"] = np.array([[[1e300, 0], [2, 3]]])  # beyond float32
    flow, valid = read_flow(tmp_path / "double.flo5")
    assert (flow.dtype, valid.tolist(), flow.tolist()) == (np.float32, [[False, True]], [[[0, 0], [2, 3]]])
    assert not [one.message for one in recwarn if one.category is not ResourceWarning]


def test_flo5_without_h5py_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    path = tmp_path / "flow.flo5"
    path.touch()
    for use in (lambda: read_flow(path), lambda: write_flow(path, np.zeros((2, 2, 2)))):
        refusal(use, AssetError, "h5py")


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
def test_writing_refuses_what_is_not_a_flow_and_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"flow{suffix}"
    wrong = [(np.zeros(shape), None) for shape in ((2, 2), (2, 2, 3), (0, 2, 2))]
    wrong += [(np.zeros((2, 2, 2), complex), None), (np.full((2, 2, 2), 2e9), None)]
    wrong += [(np.zeros((2, 2, 2)), valid) for valid in (np.ones((2, 3), bool), np.ones((2, 2), np.uint8))]
    for flow, valid in wrong:
        refusal(lambda flow=flow, valid=valid: write_flow(path, flow, valid), DataError, path)
    assert list(tmp_path.iterdir()) == []
    refusal(lambda: write_flow(tmp_path / "no" / "flow.flo", FLOW), DataError, tmp_path / "no" / "flow.flo")


def test_failed_writing_leaves_the_existing_file_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "flow.flo"
    write_flow(path, np.ones((2, 2, 2)))
    before = path.read_bytes()

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full_disk)
    refusal(lambda: write_flow(path, np.zeros((3, 3, 2))), DataError, path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
def test_truncated_flow_files_are_refused(tmp_path: Path, suffix: str) -> None:
    needs_h5py(suffix)
    path = tmp_path / f"flow{suffix}"
    write_flow(path, FLOW, np.eye(4, 5, dtype=bool))
    whole = path.read_bytes()
    end = len(whole) - 4 * (suffix == ".png")  # the checksum of a PNG's empty last chunk
    step = 37 if suffix == ".flo5" else 1  # an HDF5 file has thousands of bytes, most of them unused
    for length in [*range(0, end, step), end - 1]:
        path.write_bytes(whole[:length])
        refused(path)
    if suffix in (".flo", ".pfm", ".npy"):
        path.write_bytes(whole + b"\0")
        refused(path)


def png(height: int, width: int, data: bytes = b"") -> bytes:
    """A 16-bit RGB PNG with correct checksums."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def picture(kind: str, *channels: int) -> bytes:
    return cv2.imencode(".png", np.zeros((4, 5, *channels), kind))[1].tobytes()


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
    "huge.png": png(90_000, 90_000),
    "large.png": png(20_000, 20_000),
    "short.png": png(8, 8, zlib.compress((b"\0" + b"\1" * 48) * 6)),
    "text.png": b"<!DOCTYPE html><html></html>",
    "grey8.png": picture("u1", 1),
    "rgb8.png": picture("u1", 3),
    "rgba8.png": picture("u1", 4),
    "grey16.png": picture("u2", 1),
    "text.flo5": b"<!DOCTYPE html><html></html>",
    "unknown.tif": bytes(99),
    **{f"empty{suffix}": b"" for suffix in FLOW_SUFFIXES},
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_hostile_headers_and_images_cost_no_memory(tmp_path: Path, name: str) -> None:
    needs_h5py(name)
    refused(tmp_path / name)  # a missing file
    (tmp_path / name).write_bytes(HOSTILE[name])
    tracemalloc.start()
    try:
        refused(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def bomb(file) -> None:
    made = file.create_dataset("flow", FLOW.shape, "f4", chunks=FLOW.shape, compression="gzip")
    made.id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(80_000_000)))


DAMAGED_FLO5 = {
    "stores nothing": lambda file: file.create_dataset("flow", (8000, 8000, 2), "f4", chunks=(100, 100, 2)),
    "too many pixels": lambda file: file.create_dataset("flow", (9**5, 9**5, 2), "f4", chunks=(1, 1, 2)),
    "too long": lambda file: file.create_dataset("flow", (2**31, 2, 2), "f4", chunks=(1, 1, 2)),
    "one channel": lambda file: file.create_dataset("flow", data=FLOW[..., 0]),
    "integers": lambda file: file.create_dataset("flow", data=FLOW.astype("i4")),
    "another name": lambda file: file.create_dataset("disparity", data=FLOW),
    "a group": lambda file: file.create_group("flow"),
    "another filter": lambda file: file.create_dataset("flow", data=FLOW, compression="lzf"),
    "a chunk that inflates to 80 MB": bomb,
    "a link": lambda file: file.__setitem__("flow", __import__("h5py").ExternalLink("other.h5", "flow")),
}


@pytest.mark.parametrize("case", DAMAGED_FLO5)
def test_damaged_flo5_files_are_refused(tmp_path: Path, case: str) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["flow"] = FLOW
    with h5py.File(tmp_path / "flow.flo5", "w") as file:
        DAMAGED_FLO5[case](file)
    refused(tmp_path / "flow.flo5")


@pytest.mark.parametrize("size", [(99_999, 1), (1, 99_999), (2**13, 2**13), (100_000, 1), (1, 0), (2**13, 2**13 + 1)])
def test_sides_and_pixels_of_a_file_are_limited(size: tuple[int, int]) -> None:
    if size in ((99_999, 1), (1, 99_999), (2**13, 2**13)):
        claimed_size(Path("a"), *size)
    else:
        refusal(lambda: claimed_size(Path("a"), *size), DataError, "a")


def test_vectors_beyond_a_thousand_million_are_unknown(tmp_path: Path) -> None:
    beyond = np.nextafter(np.float32(1e9), np.float32(2e9))
    np.save(tmp_path / "a.npy", np.array([[[1e9, 0], [beyond, 0], [0, -beyond]]], np.float32))
    assert read_flow(tmp_path / "a.npy")[1].tolist() == [[True, False, False]]
    write_flow(tmp_path / "b.npy", np.full((1, 1, 2), 1e9))
    refusal(lambda: write_flow(tmp_path / "b.npy", np.full((1, 1, 2), beyond)), DataError, tmp_path / "b.npy")


@pytest.mark.parametrize(("more", "read"), [(0, True), (1, False)])
def test_a_chunk_of_flo5_inflates_to_its_size(tmp_path: Path, more: int, read: bool) -> None:
    h5py = pytest.importorskip("h5py")
    flow = np.random.default_rng(0).normal(size=(100, 100, 2)).astype(np.float32)
    with h5py.File(tmp_path / "flow.flo5", "w") as file:
        made = file.create_dataset("flow", flow.shape, "f4", chunks=flow.shape, compression="gzip")
        made.id.write_direct_chunk((0, 0, 0), zlib.compress(flow.tobytes() + bytes(more)))
    with h5py.File(tmp_path / "filters.flo5", "w") as file:
        file.create_dataset("flow", data=flow, compression="gzip", shuffle=True, fletcher32=True)
    np.testing.assert_array_equal(read_flow(tmp_path / "filters.flo5")[0], flow)
    if read:
        np.testing.assert_array_equal(read_flow(tmp_path / "flow.flo5")[0], flow)
    else:
        refused(tmp_path / "flow.flo5")
