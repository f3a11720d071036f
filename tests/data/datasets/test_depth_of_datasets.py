"""Read depth and cameras from files in each dataset's own format, for a scene of planes in front of a moving
camera.
"""

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from robustflow.core.errors import DataError
from robustflow.core.types import Camera
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.depth import with_motion
from robustflow.data.datasets.kitti import _calibration, sky
from robustflow.media.flow import write_flow
from robustflow.media.images import write_image
from tests.refusals import refusal

from .layouts import picture, placed

HEIGHT, WIDTH = 48, 64
FOCAL = 60.0
CENTRE = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
SKY_ROWS = 5


def turned(*angles):
    return Rotation.from_euler("xyz", angles).as_matrix()


def world(rotation, translation, lens=(FOCAL, FOCAL, *CENTRE), sky=0):
    """A tilted plane with a block in front of it, below `sky` rows at 10 km: the depth in frame 1, the depth of the
    same points in frame 2, and the flow.
    """
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    depth = 1 / (0.02 + 0.001 * rows + 0.0005 * columns)
    depth[10:25, 20:40] = 6.0
    depth[:sky] = 10_000
    fx, fy, cx, cy = lens
    points = np.stack([(columns - cx) / fx * depth, (rows - cy) / fy * depth, depth])
    moved = np.tensordot(rotation, points, 1) + np.reshape(translation, (3, 1, 1))
    flow = np.stack([fx * moved[0] / moved[2] + cx - columns, fy * moved[1] / moved[2] + cy - rows], axis=2)
    return SimpleNamespace(depth=depth, then=moved[2], flow=flow.astype(np.float32))


MOTION = turned(0.004, -0.01, 0.006), np.array([0.12, -0.03, -0.4])


@settings(max_examples=40, deadline=None)
@given(
    angles=st.tuples(*[st.floats(-0.06, 0.06)] * 3),
    moved=st.tuples(*[st.floats(-0.8, 0.8)] * 3),
    seed=st.integers(0, 2**32),
)
def test_camera_motion_is_fitted_despite_moving_objects(angles, moved, seed):
    rotation, translation = turned(*angles), np.array(moved)
    scene, rng = world(rotation, translation), np.random.default_rng(seed)
    flow = scene.flow + rng.normal(0, 0.02, scene.flow.shape).astype(np.float32)
    flow[30:45, 5:30] += 9  # a car
    known = rng.random(scene.depth.shape) < 0.4
    fitted = with_motion(Camera((FOCAL, FOCAL), CENTRE), scene.depth, flow, known)
    np.testing.assert_allclose(fitted.rotation, rotation, atol=2e-3)
    np.testing.assert_allclose(fitted.translation, translation, atol=3e-2)
    np.testing.assert_allclose(fitted.rotation @ fitted.rotation.T, np.eye(3), atol=1e-12)


def test_camera_motion_supported_by_few_points_is_unknown():
    scene = world(*MOTION)
    known = np.zeros(scene.depth.shape, bool)
    known[::12, ::12] = True
    assert with_motion(Camera((FOCAL, FOCAL), CENTRE), scene.depth, scene.flow, known).rotation is None
    flat = with_motion(Camera((FOCAL, FOCAL), CENTRE), 0 * scene.depth, scene.flow, scene.depth > 0)
    assert flat.rotation is None


def check_second(depth, scene):
    """Assert that the second map is the depth of the scene's points at the ends of their flow vectors."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    there = np.rint(np.dstack([columns, rows]) + scene.flow).astype(int)
    inside = ((there >= 0) & (there < (WIDTH, HEIGHT))).all(axis=2) & (scene.depth != 6)
    second, wanted = depth.maps[1][there[inside][:, 1], there[inside][:, 0]], scene.then[inside]
    assert (np.abs(second / wanted - 1) < 0.05).mean() > 0.85


def kitti(root, scene, baseline=0.54):
    training = root / "training"
    for number in (10, 11):
        frame = picture(training / "image_2" / f"000010_{number}.png", HEIGHT, WIDTH)
        frame[:SKY_ROWS] = 250
        write_image(training / "image_2" / f"000010_{number}.png", frame)
    known = np.ones((HEIGHT, WIDTH), bool)
    known[:SKY_ROWS] = known[:, ::3] = False  # the sky, and the gaps between the scan lines
    write_flow(placed(training / "flow_occ" / "000010_10.png"), scene.flow, known)
    for name, metres in (("disp_occ_0", scene.depth), ("disp_occ_1", scene.then)):
        values = np.rint(256 * np.where(known, FOCAL * baseline / metres, 0)).astype("<u2")
        image = Image.frombytes("I;16", (WIDTH, HEIGHT), values.tobytes())
        image.save(placed(training / name / "000010_10.png"))
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02", "S_02: 1.392000e+03 5.120000e+02"]
    for camera, x, others in (
        ("02", 44.85728, (0.2163791, 0.002745884)),
        ("03", 44.85728 - FOCAL * baseline, (2.2, 0)),
    ):
        matrix = (FOCAL, 0, CENTRE[0], x, 0, FOCAL, CENTRE[1], others[0], 0, 0, 1, others[1])
        lines.append(f"P_rect_{camera}: " + " ".join(f"{value:.6e}" for value in matrix))
    placed(training / "calib_cam_to_cam" / "000010.txt").write_text("\n".join(lines) + "\n")
    return training


def test_kitti_has_depth_by_disparity_and_calibration_and_a_fitted_camera(tmp_path):
    scene = world(*MOTION)
    # the real 0.54 m would give too small a disparity at a width of 64 pixels
    training = kitti(tmp_path, scene, baseline=20.0)
    data = load_dataset("kitti2015", tmp_path)
    sample = data.load("000010")
    depth = data.depth(sample)
    np.testing.assert_array_equal(depth.measured[0], sample.valid)
    quantized = np.rint(256 * FOCAL * 20.0 / scene.depth[sample.valid])
    np.testing.assert_allclose(depth.maps[0][sample.valid], FOCAL * 20.0 * 256 / quantized, rtol=1e-6)
    assert (depth.maps[0][:SKY_ROWS] == 10_000).all()
    assert depth.maps[0][SKY_ROWS:].max() < 100
    check_second(depth, scene)
    np.testing.assert_allclose(depth.camera.intrinsics(1), (FOCAL, FOCAL, *CENTRE))
    np.testing.assert_allclose(depth.camera.rotation, MOTION[0], atol=2e-3)
    np.testing.assert_allclose(depth.camera.translation, MOTION[1], atol=0.03)
    files = data.depth_files("000010")
    assert [path.relative_to(training).as_posix() for path in files] == [
        "disp_occ_0/000010_10.png", "disp_occ_1/000010_10.png", "calib_cam_to_cam/000010.txt"
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["", "P_rect_02: 1 2 3\nP_rect_03: 1\n", "P_rect_02: a b", "\xff", "P_rect_02: 1 0 0 nan 0 1 0 0 0 0 1 0\n" * 2],
)
def test_a_damaged_calibration_of_kitti_is_refused(tmp_path, text):
    training = kitti(tmp_path, world(*MOTION))
    (training / "calib_cam_to_cam" / "000010.txt").write_text(text, encoding="latin-1")
    data = load_dataset("kitti2015", tmp_path)
    refusal(lambda: data.depth(data.load("000010")), DataError, training / "calib_cam_to_cam" / "000010.txt")


def sintel(root, scene, first, second, zoom=1.0):
    training = root / "training"
    for number, metres, pose, focal in ((1, scene.depth, first, FOCAL), (2, scene.then, second, zoom * FOCAL)):
        picture(training / "clean" / "alley_1" / f"frame_{number:04d}.png", HEIGHT, WIDTH)
        values = struct.pack("<fii", 202021.25, WIDTH, HEIGHT) + metres.astype("<f4").tobytes()
        placed(training / "depth" / "alley_1" / f"frame_{number:04d}.dpt").write_bytes(values)
        lens = (focal, 0, CENTRE[0], 0, focal, CENTRE[1], 0, 0, 1)
        values = struct.pack("<f9d12d", 202021.25, *lens, *pose.ravel())
        placed(training / "camdata_left" / "alley_1" / f"frame_{number:04d}.cam").write_bytes(values)
    write_flow(placed(training / "flow" / "alley_1" / "frame_0001.flo"), scene.flow)
    return training


def test_sintel_has_the_depth_and_the_cameras_of_its_files(tmp_path):
    first = np.column_stack([turned(0.3, -1, 2), [4.0, 5.0, 6.0]])
    second = np.column_stack([MOTION[0] @ first[:, :3], MOTION[0] @ first[:, 3] + MOTION[1]])
    scene = world(*MOTION)
    training = sintel(tmp_path, scene, first, second, zoom=1.25)
    data = load_dataset("sintel", tmp_path)
    assert data.keys() == ["alley_1/frame_0001"]  # its new folders are not rendering passes
    depth = data.depth(data.load("alley_1/frame_0001"))
    np.testing.assert_array_equal(depth.maps[0], scene.depth.astype(np.float32))
    np.testing.assert_array_equal(depth.maps[1], scene.then.astype(np.float32))
    np.testing.assert_allclose(depth.camera.rotation, MOTION[0], atol=1e-12)
    np.testing.assert_allclose(depth.camera.translation, MOTION[1], atol=1e-12)
    assert depth.camera.intrinsics(0)[:2] == (FOCAL, FOCAL)
    assert depth.camera.intrinsics(1)[:2] == (1.25 * FOCAL, 1.25 * FOCAL)
    for path in sorted((training / "depth").rglob("*.dpt")) + sorted(training.rglob("*.cam")):
        whole = path.read_bytes()
        for damaged in (whole[:-1], b"", whole[:10], b"HEIP" + whole[4:], whole + b"x"):
            path.write_bytes(damaged)
            refusal(lambda: data.depth(data.load("alley_1/frame_0001")), DataError, path)
        path.write_bytes(whole)
    path = training / "depth" / "alley_1" / "frame_0002.dpt"
    path.unlink()
    refusal(lambda: data.depth_files("alley_1/frame_0001"), DataError, path)


AXES = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
"""TartanAir's axes (x forward, y right, z down) from those of a camera (x right, y down, z forward)."""


def ned(rotation, place):
    """One line of a pose file, with a quaternion, from a camera-to-world rotation and the camera's place."""
    turn = rotation @ AXES.T
    w = np.sqrt(max(0, 1 + np.trace(turn))) / 2
    x, y, z = (turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    return [*place, x / (4 * w), y / (4 * w), z / (4 * w), w]


def tartanair(root, scene, poses):
    flight = root / "office" / "Easy" / "P000"
    np.savetxt(placed(flight / "pose_left.txt"), poses)
    for number, metres in enumerate((scene.depth, scene.then)):
        picture(flight / "image_left" / f"{number:06d}_left.png", HEIGHT, WIDTH)
        np.save(placed(flight / "depth_left" / f"{number:06d}_left_depth.npy"), metres.astype(np.float32))
    np.save(placed(flight / "flow" / "000000_000001_flow.npy"), scene.flow)
    np.save(flight / "flow" / "000000_000001_mask.npy", np.zeros((HEIGHT, WIDTH), np.uint8))
    return flight


def test_tartanair_has_the_depth_and_the_poses_of_its_files(tmp_path):
    lens = (320.0, 320.0, 320.0, 240.0)
    scene = world(*MOTION, lens)
    to_world, place = AXES @ turned(0.1, 0.4, -0.2), np.array([3.0, -8.0, 1.5])
    other_to_world = to_world @ MOTION[0].T
    other = place - other_to_world @ MOTION[1]
    flight = tartanair(tmp_path, scene, [ned(to_world, place), ned(other_to_world, other)])
    data = load_dataset("tartanair", tmp_path)
    depth = data.depth(data.load("office/Easy/P000/000000"))
    np.testing.assert_array_equal(depth.maps, np.float32([scene.depth, scene.then]))
    np.testing.assert_allclose(depth.camera.rotation, MOTION[0], atol=1e-9)
    np.testing.assert_allclose(depth.camera.translation, MOTION[1], atol=1e-9)
    assert depth.camera.intrinsics(1) == lens
    for text in ("", "1 2 3\n", "1 2 3 0 0 0 0\n" * 2, "1 2 3 0 0 0 1\n", "nan 2 3 0 0 0 1\n" * 2, "\xff"):
        (flight / "pose_left.txt").write_text(text, encoding="latin-1")
        refusal(lambda: data.depth(data.load("office/Easy/P000/000000")), DataError, flight / "pose_left.txt")


def test_tartanair_moves_the_camera_along_the_axes_of_a_north_east_down_world(tmp_path):
    """A camera that looks east and moves 0.5 m north, 0.25 m east and 0.1 m down."""
    half = 0.5**0.5  # a quarter turn about the axis that points down
    tartanair(tmp_path, world(*MOTION), [(1, 2, 3, 0, 0, half, half), (1.5, 2.25, 3.1, 0, 0, half, half)])
    data = load_dataset("tartanair", tmp_path)
    camera = data.depth(data.load("office/Easy/P000/000000")).camera
    np.testing.assert_allclose(camera.rotation, np.eye(3), atol=1e-12)
    # looking east, south is to the right; points move against the camera: right, up, back
    np.testing.assert_allclose(camera.translation, (0.5, -0.1, -0.25), atol=1e-12)


@pytest.mark.parametrize("direction", ["FW", "BW"])
def test_spring_has_the_depth_of_its_disparity_and_a_fitted_camera(tmp_path, direction):
    h5py = pytest.importorskip("h5py")
    sequence = tmp_path / "train" / "0004"
    scene = world(*MOTION, sky=2)
    first = 1 if direction == "FW" else 2
    maps = {first: scene.depth, 3 - first: scene.then}
    np.savetxt(placed(sequence / "cam_data" / "intrinsics.txt"), [[FOCAL, FOCAL, *CENTRE]] * 2)
    for number, metres in maps.items():
        picture(sequence / "frame_left" / f"frame_left_{number:04d}.png", HEIGHT, WIDTH)
        disparity = (FOCAL * 0.065 / metres).repeat(2, axis=0).repeat(2, axis=1)
        disparity[:4] *= number != first  # either way of storing the sky
        disparity[::2, 6] = np.nan
        disparity[1::2] = disparity[:, 1::2] = 99  # values that the benchmark does not read
        with h5py.File(placed(sequence / "disp1_left" / f"disp1_left_{number:04d}.dsp5"), "w") as file:
            file.create_dataset("disparity", data=disparity.astype(np.float32), compression="gzip")
    path = placed(sequence / f"flow_{direction}_left" / f"flow_{direction}_left_{first:04d}.flo5")
    write_flow(path, scene.flow.repeat(2, axis=0).repeat(2, axis=1))
    data = load_dataset("spring", tmp_path, direction=direction)
    depth = data.depth(data.load(data.keys()[0]))
    measured = depth.measured[0]
    assert not measured[:, 3].any()
    assert measured.mean() == 1 - 1 / WIDTH
    for map_, metres in zip(depth.maps, (scene.depth, scene.then), strict=True):
        np.testing.assert_allclose(map_[measured], np.minimum(metres, 10_000)[measured], rtol=1e-5)
    np.testing.assert_allclose(depth.camera.rotation, MOTION[0], atol=1e-5)
    np.testing.assert_allclose(depth.camera.translation, MOTION[1], atol=1e-4)
    np.savetxt(sequence / "cam_data" / "intrinsics.txt", [[FOCAL, FOCAL, *CENTRE]])
    intrinsics, damaged = sequence / "cam_data" / "intrinsics.txt", sequence / "disp1_left" / "disp1_left_0001.dsp5"
    refusal(lambda: data.depth(data.load(data.keys()[0])), DataError, intrinsics)
    np.savetxt(sequence / "cam_data" / "intrinsics.txt", [[FOCAL, FOCAL, *CENTRE]] * 2)
    damaged.write_bytes(b"no HDF5")
    refusal(lambda: data.depth(data.load(data.keys()[0])), DataError, damaged)


@pytest.mark.parametrize(
    ("blue", "width", "top", "measured", "is_sky"),
    [
        *((240, 100, 0, 0, True), (239, 100, 0, 0, False)),
        *((255, 100, 0, 99, True), (255, 100, 0, 100, False)),
        *((255, 5, 0, 0, True), (255, 4, 0, 0, False)),
        (255, 100, 1, 0, False),
    ],
)
def test_sky_is_blue_of_240_five_pixels_wide_at_the_upper_edge_and_less_than_a_hundredth_is_measured(
    blue, width, top, measured, is_sky
):
    frame, known = np.zeros((160, 160, 3), np.uint8), np.zeros((160, 160), bool)
    frame[top : 100 + top, 10 : 10 + width, 2] = blue
    known[3, 10 : 10 + measured] = True
    frame[100 + top : 120 + top, 10 + width : 30 + width, 2] = blue  # touches it at a corner
    expected = np.zeros((160, 160), bool)
    expected[:100, 10 : 10 + width] = is_sky
    np.testing.assert_array_equal(sky(frame, known), expected)


@pytest.mark.parametrize(("focal", "baseline", "read"), [(999_999, 1, True), (1_000_000, 1, False), (1, 0, False)])
def test_focal_lengths_and_baseline_of_kitti_are_positive_and_below_a_million(tmp_path, focal, baseline, read):
    path = tmp_path / "calibration.txt"
    path.write_text(f"P_rect_02: {focal} 0 0 1 0 1 0 0 0 0 1 0\nP_rect_03: 1 0 0 {1 - baseline} 0 1 0 0 0 0 1 0\n")
    if read:
        camera, scale = _calibration(path)
        assert (camera.focal, scale) == ((focal, 1), baseline)
    else:
        refusal(lambda: _calibration(path), DataError, path)
