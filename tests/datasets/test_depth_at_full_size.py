"""Read depth and cameras from full-size files written by independent code: Pillow, h5py or plain bytes."""

import struct
from array import array

import numpy as np
import pytest
from PIL import Image

from robustflow.datasets import load_dataset
from robustflow.flowio import write_flow


def at_full_size(shape):
    """Disparity of a slope, a sky in the upper third, and a gap of unknown pixels, float64."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] / np.array(shape).reshape(2, 1, 1)
    disparity = 5 + 60 * rows + 7 * columns
    disparity[: shape[0] // 3] = 0
    return disparity


def blank(path, height, width):
    """Write a black frame with Pillow."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (width, height)).save(path, compress_level=1)


KITTI_CALIBRATION = """calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_02: 1.392000e+03 5.120000e+02
K_02: 9.597910e+02 0.000000e+00 6.960217e+02 0.000000e+00 9.569251e+02 2.241806e+02 0.000000e+00 0.000000e+00 1.000000e+00
S_rect_02: 1.242000e+03 3.750000e+02
P_rect_02: 7.215377e+02 0.000000e+00 6.095593e+02 4.485728e+01 0.000000e+00 7.215377e+02 1.728540e+02 2.163791e-01 0.000000e+00 0.000000e+00 1.000000e+00 2.745884e-03
P_rect_03: 7.215377e+02 0.000000e+00 6.095593e+02 -3.395242e+02 0.000000e+00 7.215377e+02 1.728540e+02 2.199936e+00 0.000000e+00 0.000000e+00 1.000000e+00 2.729905e-03
"""  # noqa: E501


def test_kitti_at_full_size_has_the_depth_of_the_development_kits_formula(tmp_path):
    """Depth is 721.5377 px times 0.5327 m / (value / 256), for files written by Pillow and a calibration in KITTI's
    format.
    """
    shape, training = (375, 1242), tmp_path / "training"
    for number in (10, 11):
        blank(training / "image_2" / f"000000_{number}.png", *shape)
    disparity = at_full_size(shape)
    values = np.floor(disparity * 256).astype("<u2")
    for name in ("disp_occ_0", "disp_occ_1"):
        (training / name).mkdir()
        Image.frombytes("I;16", shape[::-1], values.tobytes()).save(training / name / "000000_10.png")
    (training / "calib_cam_to_cam").mkdir()
    (training / "calib_cam_to_cam" / "000000.txt").write_text(KITTI_CALIBRATION)
    (training / "flow_occ").mkdir()
    write_flow(training / "flow_occ" / "000000_10.png", np.zeros((*shape, 2), np.float32), disparity > 0)
    data = load_dataset("kitti2015", tmp_path)
    depth = data.depth(data.load("000000"))
    known = disparity > 0
    for map_, measured in zip(depth.maps, depth.measured, strict=True):
        np.testing.assert_array_equal(measured, known)
        expected = 721.5377 * 0.5327254 / (values[known] / 256)
        np.testing.assert_allclose(map_[known], expected, rtol=1e-6)
    np.testing.assert_allclose(depth.camera.intrinsics(0), (721.5377, 721.5377, 609.5593, 172.854))


def test_sintel_at_full_size_has_the_depth_and_cameras_of_its_development_kits_layout(tmp_path):
    """The files are packed byte by byte: tag, width, height and rows for depth; tag and two matrices for cameras."""
    shape, training = (436, 1024), tmp_path / "training"
    metres = 300 / (1 + at_full_size(shape))
    lens = [1120.0, 0.0, 511.5, 0.0, 1120.0, 217.5, 0.0, 0.0, 1.0]
    for number, ahead in ((1, 0.0), (2, 0.25)):
        name = f"frame_{number:04d}"
        blank(training / "final" / "alley_2" / f"{name}.png", *shape)
        for kind in ("depth", "camdata_left"):
            (training / kind / "alley_2").mkdir(parents=True, exist_ok=True)
        packed = struct.pack("<fii", 202021.25, shape[1], shape[0]) + array("f", metres.ravel()).tobytes()
        (training / "depth" / "alley_2" / f"{name}.dpt").write_bytes(packed)
        pose = [1.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 3.0, 0.0, 0.0, 1.0, -ahead]
        packed = struct.pack("<f9d12d", 202021.25, *lens, *pose)
        (training / "camdata_left" / "alley_2" / f"{name}.cam").write_bytes(packed)
    (training / "flow" / "alley_2").mkdir(parents=True)
    write_flow(training / "flow" / "alley_2" / "frame_0001.flo", np.zeros((*shape, 2), np.float32))
    data = load_dataset("sintel", tmp_path, render_pass="final")
    depth = data.depth(data.load("alley_2/frame_0001"))
    np.testing.assert_array_equal(depth.maps[1], metres.astype(np.float32))
    assert depth.camera.intrinsics(1) == (1120.0, 1120.0, 511.5, 217.5)
    # a camera that moves forward brings points closer
    np.testing.assert_array_equal(depth.camera.rotation, np.eye(3))
    np.testing.assert_array_equal(depth.camera.translation, (0, 0, -0.25))


def test_tartanair_at_full_size_moves_the_camera_along_the_axes_of_a_north_east_down_world(tmp_path):
    """A camera that looks east and moves 0.5 m north, 0.25 m east and 0.1 m down."""
    shape, flight = (480, 640), tmp_path / "ocean" / "Hard" / "P003"
    metres = (300 / (1 + at_full_size(shape))).astype("<f4")
    for kind in ("flow", "depth_left"):
        (flight / kind).mkdir(parents=True)
    for number in range(2):
        blank(flight / "image_left" / f"{number:06d}_left.png", *shape)
        header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
        packed = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + metres.tobytes()
        (flight / "depth_left" / f"{number:06d}_left_depth.npy").write_bytes(packed)
    np.save(flight / "flow" / "000000_000001_flow.npy", np.zeros((*shape, 2), np.float32))
    np.save(flight / "flow" / "000000_000001_mask.npy", np.zeros(shape, np.uint8))
    half = 0.5**0.5  # a quarter turn about the axis that points down
    (flight / "pose_left.txt").write_text(f"1.0 2.0 3.0 0.0 0.0 {half} {half}\n1.5 2.25 3.1 0.0 0.0 {half} {half}\n")
    data = load_dataset("tartanair", tmp_path)
    depth = data.depth(data.load("ocean/Hard/P003/000000"))
    np.testing.assert_array_equal(depth.maps[0], metres)
    np.testing.assert_allclose(depth.camera.rotation, np.eye(3), atol=1e-12)
    # looking east, south is to the right; points move against the camera: right, up, back
    np.testing.assert_allclose(depth.camera.translation, (0.5, -0.1, -0.25), atol=1e-12)


def test_spring_at_full_size_has_the_depth_of_its_formula_and_a_sky_at_10_km(tmp_path):
    """Disparity maps have 3840x2160 values, in pixels of the frames; depth is fx times 0.065 m / disparity."""
    h5py = pytest.importorskip("h5py")
    shape, sequence = (1080, 1920), tmp_path / "train" / "0001"
    disparity = at_full_size((2160, 3840)).astype(np.float32)
    disparity[1000:1100, 500:600] = np.nan
    for number in (1, 2):
        blank(sequence / "frame_left" / f"frame_left_{number:04d}.png", *shape)
        (sequence / "disp1_left").mkdir(exist_ok=True)
        with h5py.File(sequence / "disp1_left" / f"disp1_left_{number:04d}.dsp5", "w") as file:
            file["disparity"] = disparity
    (sequence / "cam_data").mkdir()
    (sequence / "cam_data" / "intrinsics.txt").write_text("2666.67 2666.67 960.0 540.0\n" * 2)
    (sequence / "flow_FW_left").mkdir()
    with h5py.File(sequence / "flow_FW_left" / "flow_FW_left_0001.flo5", "w") as file:
        file["flow"] = np.zeros((2160, 3840, 2), np.float32)
    data = load_dataset("spring", tmp_path)
    depth = data.depth(data.load("0001/0001"))
    own = disparity[::2, ::2].astype(np.float64)
    assert depth.maps[0].shape == shape
    np.testing.assert_array_equal(depth.measured[0], np.isfinite(own))
    np.testing.assert_allclose(depth.maps[0][own == 0], 10_000, rtol=1e-6)
    known = own > 0
    np.testing.assert_allclose(depth.maps[0][known], 2666.67 * 0.065 / own[known], rtol=1e-6)
