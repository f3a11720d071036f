"""Values written in any format are read back unchanged, and an independent reader agrees."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from robustflow.core.errors import AssetError, DataError
from robustflow.media.flow import FLOW_SUFFIXES, read_flow, write_flow
from tests.refusals import refused

SHAPES = st.tuples(st.integers(1, 7), st.integers(1, 7))
quick = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)


@st.composite
def flows(draw: st.DrawFn, limit: float, non_finite: bool = False) -> tuple[np.ndarray, np.ndarray]:
    shape = draw(SHAPES)
    numbers = st.floats(-limit, limit, width=32)
    if non_finite:
        numbers = numbers | st.sampled_from([np.nan, np.inf, -np.inf])
    return draw(hnp.arrays(np.float32, (*shape, 2), elements=numbers)), draw(hnp.arrays(np.bool_, shape))


@pytest.mark.parametrize("suffix", [".flo", ".pfm", ".flo5"])
@given(data=flows(1e8, non_finite=True))
@quick
def test_float_formats_keep_every_bit(tmp_path: Path, suffix: str, data: tuple[np.ndarray, np.ndarray]) -> None:
    if suffix == ".flo5":
        pytest.importorskip("h5py")
    flow, valid = data
    path = tmp_path / f"flow{suffix}"
    write_flow(path, flow, valid)
    read, known = read_flow(path)
    expected = valid & np.isfinite(flow).all(axis=2)
    assert read.dtype == np.float32
    assert known.dtype == np.bool_
    np.testing.assert_array_equal(known, expected)
    np.testing.assert_array_equal(read, np.where(expected[..., None], flow, 0))
    assert list(tmp_path.iterdir()) == [path]


@given(data=flows(511.984375, non_finite=True))
@quick
def test_kitti_rounds_to_the_nearest_64th(tmp_path: Path, data: tuple[np.ndarray, np.ndarray]) -> None:
    flow, valid = data
    write_flow(tmp_path / "flow.png", flow, valid)
    read, known = read_flow(tmp_path / "flow.png")
    expected = valid & np.isfinite(flow).all(axis=2)
    np.testing.assert_array_equal(known, expected)
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


@pytest.mark.parametrize("value", [512.0, -512.1, 511.9999])
def test_kitti_refuses_valid_vectors_beyond_its_range(tmp_path: Path, value: float) -> None:
    flow = np.zeros((2, 2, 2), np.float32)
    flow[1, 0, 1] = value
    with pytest.raises(DataError, match=r"KITTI's -512 to 511\.984375"):
        write_flow(tmp_path / "flow.png", flow)
    assert list(tmp_path.iterdir()) == []
    write_flow(tmp_path / "flow.png", flow, np.array([[True, True], [False, True]]))
    assert read_flow(tmp_path / "flow.png")[1].sum() == 3


def test_kitti_encoding_equals_hand_computed_values(tmp_path: Path) -> None:
    """The development kit's formula, in OpenCV's BGR order."""
    raw = np.zeros((1, 2, 3), np.uint16)
    raw[0, 0] = (1, 32768 - 64 * 3, 32768 + 32)  # valid, v = -3, u = 0.5
    raw[0, 1] = (0, 40000, 40000)
    cv2.imwrite(str(tmp_path / "flow.png"), raw)
    flow, valid = read_flow(tmp_path / "flow.png")
    assert valid.tolist() == [[True, False]]
    assert flow.tolist() == [[[0.5, -3.0], [0.0, 0.0]]]


def test_an_exif_orientation_does_not_turn_a_flow_map(tmp_path: Path) -> None:
    flow = np.arange(40, dtype=np.float32).reshape(4, 5, 2)
    write_flow(tmp_path / "flow.png", flow)
    exif = Image.Exif()
    exif[0x0112] = 3
    content = b"eXIf" + exif.tobytes().removeprefix(b"Exif\0\0")
    chunk = struct.pack(">I", len(content) - 4) + content + struct.pack(">I", zlib.crc32(content))
    whole = (tmp_path / "flow.png").read_bytes()
    (tmp_path / "flow.png").write_bytes(whole[:33] + chunk + whole[33:])
    np.testing.assert_array_equal(read_flow(tmp_path / "flow.png")[0], flow)


@given(data=flows(1e8))
@quick
def test_flo_agrees_with_opencv_both_ways(tmp_path: Path, data: tuple[np.ndarray, np.ndarray]) -> None:
    flow, _ = data
    write_flow(tmp_path / "ours.flo", flow)
    np.testing.assert_array_equal(cv2.readOpticalFlow(str(tmp_path / "ours.flo")), flow)
    cv2.writeOpticalFlow(str(tmp_path / "theirs.flo"), flow)
    np.testing.assert_array_equal(read_flow(tmp_path / "theirs.flo")[0], flow)


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


@given(data=flows(1e8))
@quick
def test_pfm_agrees_with_opencv(tmp_path: Path, data: tuple[np.ndarray, np.ndarray]) -> None:
    flow, _ = data
    write_flow(tmp_path / "flow.pfm", flow)
    by_opencv = cv2.imread(str(tmp_path / "flow.pfm"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(by_opencv[..., :0:-1], flow)


def test_flo5_is_the_dataset_flow_with_nan(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    write_flow(tmp_path / "flow.flo5", np.ones((2, 3, 2)), np.eye(2, 3, dtype=bool))
    with h5py.File(tmp_path / "flow.flo5") as file:
        stored = file["flow"][()]
    np.testing.assert_array_equal(np.isfinite(stored).all(axis=2), np.eye(2, 3, dtype=bool))
    with h5py.File(tmp_path / "half.flo5", "w") as file:
        file["flow"] = np.full((2, 2, 2), 0.5, np.float64)
    assert read_flow(tmp_path / "half.flo5")[0].dtype == np.float32


def test_a_flo5_beyond_float32_is_unknown_without_a_warning(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.flo5", "w") as file:
        file["flow"] = np.array([[[1e300, 0], [2, 3]]])
    flow, valid = read_flow(tmp_path / "a.flo5")
    assert valid.tolist() == [[False, True]]
    assert flow.tolist() == [[[0, 0], [2, 3]]]
    assert not recwarn.list


def test_flo5_without_h5py_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    path = tmp_path / "flow.flo5"
    path.touch()
    for use in (lambda: read_flow(path), lambda: write_flow(path, np.zeros((2, 2, 2)))):
        with pytest.raises(AssetError, match=r"pip install 'robustflow\[h5\]'"):
            use()


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
def test_writing_refuses_what_is_not_a_flow_and_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"flow{suffix}"
    for flow in (np.zeros((2, 2)), np.zeros((2, 2, 3)), np.zeros((0, 2, 2)), np.zeros((2, 2, 2), complex)):
        with pytest.raises(DataError, match=r"\(H, W, 2\)"):
            write_flow(path, flow)
    for valid in (np.ones((2, 3), bool), np.ones((2, 2), np.uint8)):
        with pytest.raises(DataError, match="valid is"):
            write_flow(path, np.zeros((2, 2, 2)), valid)
    with pytest.raises(DataError, match=r"1e9|KITTI"):
        write_flow(path, np.full((2, 2, 2), 2e9))
    assert list(tmp_path.iterdir()) == []


def test_failed_writing_leaves_the_existing_file_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "flow.flo"
    write_flow(path, np.ones((2, 2, 2)))
    before = path.read_bytes()

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full_disk)
    with pytest.raises(DataError, match="No space left on device"):
        write_flow(path, np.zeros((3, 3, 2)))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_writing_into_a_missing_folder_is_refused_in_one_line(tmp_path: Path) -> None:
    with refused(DataError, "cannot write"):
        write_flow(tmp_path / "no" / "flow.flo", np.zeros((2, 2, 2)))
