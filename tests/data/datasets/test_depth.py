"""Test that the depth of samples is filled in, warped to frame 2, and read from the files of datasets."""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.ndimage import binary_erosion

from robustflow.core.errors import DataError, UsageError
from robustflow.core.types import Camera, Sample
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.dataset import Depths
from robustflow.data.datasets.depth import carried, completed, scene_depth
from robustflow.data.datasets.own_depth import OwnDepth
from robustflow.data.datasets.shapes.render import layer_depths
from robustflow.data.datasets.still import Still
from robustflow.media.images import write_image
from tests.corruptions.pictures import picture
from tests.refusals import refusal

from .layouts import placed

CAMERA = Camera((10.0, 10.0), (2.0, 2.0))
PAIR = Sample("7", (np.zeros((4, 4, 3), np.uint8),) * 2)


def filled_in_plain_python(depth):
    known = np.isfinite(depth) & (depth > 0)
    rows = {}
    for y in np.flatnonzero(known.any(axis=1)):
        at = np.flatnonzero(known[y])
        neighbours = [(at[at <= x][-1:], at[at >= x][:1]) for x in range(depth.shape[1])]
        rows[y] = [max(depth[y, place] for place in (*left, *right)) for left, right in neighbours]
    out = np.empty(depth.shape)
    for y in range(depth.shape[0]):
        above, below = [r for r in rows if r <= y][-1:], [r for r in rows if r >= y][:1]
        out[y] = np.max([rows[r] for r in (*above, *below)], axis=0)
    return out


@settings(max_examples=150, deadline=None)
@given(
    arrays.arrays(
        np.float32,
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=7),
        elements=st.sampled_from([0.0, 0.0, 0.0, np.nan, np.inf, 1.0, 2.5, 80.0]),
    )
)
def test_holes_take_the_farther_of_their_measured_neighbours(values):
    known = np.isfinite(values) & (values > 0)
    if not known.any():
        refusal(lambda: completed(values), DataError, "the depth map")
        return
    depth, measured = completed(values)
    np.testing.assert_array_equal(measured, known)
    np.testing.assert_array_equal(depth, filled_in_plain_python(values))


@pytest.mark.parametrize(
    "values", [np.full((4, 4), np.nan), np.zeros((4, 4)), np.full((4, 4), -1.0), np.ones((4, 5)), np.ones((4, 4, 1))]
)
def test_invalid_depth_map_is_refused(values):
    refusal(lambda: scene_depth(np.ones((4, 4)), values, CAMERA, "maps", PAIR), DataError, "maps, sample '7', frame 2")


@pytest.mark.parametrize(("metres", "warned"), [(0.05, True), (0.1, False), (9e3, False), (2e4, True)])
def test_implausible_median_depth_warns_of_a_wrong_unit(metres, warned, recwarn):
    scene_depth(np.full((4, 4), metres), np.full((4, 4), metres), CAMERA, "maps", PAIR)
    assert len(recwarn) == warned


def test_nearest_of_points_that_meet_in_frame_2_is_visible():
    flow = np.zeros((1, 4, 2), np.float32)
    flow[0, :, 0] = 2, 1, 0, -1
    found = carried(np.array([[5.0, 3.0, 9.0, 1.0]]), flow, np.array([[True, True, True, False]]))
    assert found.tolist() == [[0.0, 0.0, 3.0, 0.0]]


def test_shapes_have_the_depth_of_the_layer_that_is_seen_in_both_frames():
    data = load_dataset("shapes", pairs=3, size="96x128")
    assert isinstance(data, Depths)
    for sample in data:
        depth = data.depth(sample)
        assert depth.maps[0].max() == 100
        assert 5 <= depth.maps[0].min() < 100
        rows, columns = np.mgrid[:96, :128]
        there = np.rint(np.dstack([columns, rows]) + sample.flow).astype(int)
        seen = ~sample.occluded
        follows = depth.maps[1][there[seen][:, 1], there[seen][:, 0]] == depth.maps[0][seen]
        assert follows.mean() > 0.97  # all pixels except those at the edges of layers
        inside = ((there >= 0) & (there < (128, 96))).all(axis=2)
        hidden = binary_erosion(sample.occluded, iterations=2) & inside
        nearer = depth.maps[1][there[hidden][:, 1], there[hidden][:, 0]] < depth.maps[0][hidden]
        assert nearer.mean() > 0.95


def test_layers_run_from_5_to_100_metres_evenly_in_inverse_depth():
    inverse = 1 / layer_depths(6).astype(float)
    np.testing.assert_allclose(np.diff(inverse), (0.01 - 0.2) / 5, rtol=1e-5)
    assert layer_depths(1).tolist() == [5.0]


@pytest.fixture(scope="module")
def motorcycle():
    """The embedded pair: the dataset, its sample, and the sample's depth."""
    data = load_dataset("motorcycle")
    return data, data["motorcycle"], data.depth(data["motorcycle"])


def test_motorcycle_moves_by_its_baseline_as_its_disparity_says(motorcycle):
    """A point that is back-projected, moved by the camera motion and projected again ends where the true flow ends."""
    _, sample, depth = motorcycle
    valid = depth.measured[0]
    np.testing.assert_array_equal(valid, sample.valid)
    rows, columns = np.nonzero(valid)
    fx, fy, cx, cy = depth.camera.intrinsics(0)
    metres = depth.maps[0][valid].astype(float)
    points = np.stack([(columns - cx) * metres / fx, (rows - cy) * metres / fy, metres])
    moved = depth.camera.rotation @ points + depth.camera.translation[:, None]
    fx, fy, cx, cy = depth.camera.intrinsics(1)
    np.testing.assert_allclose(fx * moved[0] / moved[2] + cx - columns, sample.flow[valid, 0], atol=2e-4)
    np.testing.assert_allclose(fy * moved[1] / moved[2] + cy, rows, atol=1e-4)
    assert 2 < metres.min() < metres.max() < 6  # a room


def test_a_still_scene_has_the_depth_of_its_frame_twice_and_a_camera_at_rest(motorcycle):
    data, _, pair = motorcycle
    still = Still(data, ["motorcycle"])
    for which, sample in enumerate(still):
        depth = still.depth(sample)
        for each in depth.maps:
            np.testing.assert_array_equal(each, pair.maps[which])
        assert not depth.camera.translation.any()
        assert depth.camera.intrinsics(1) == pair.camera.intrinsics(which)
        assert still.depth_files(sample.key) == data.files("motorcycle")[2:]


def pictures_of(folder, *names, shape=(40, 56)):
    for number, name in enumerate(names):
        write_image(placed(folder / name), picture(*shape, seed=number))
    return folder


@pytest.fixture
def clip(tmp_path):
    return load_dataset("folder", pictures_of(tmp_path / "clip", "a.png", "b.png"))


def metres(shape=(40, 56)):
    """A ramp from 2 to 60 m with a hole."""
    values = np.linspace(2, 60, shape[0] * shape[1], dtype=np.float32).reshape(shape)
    values[3:5, 7:9] = 0
    return values


def write_map(path, values):
    if placed(path).suffix == ".png":
        assert cv2.imwrite(str(path), np.rint(values * 1000).astype(np.uint16))
    elif path.suffix == ".npy":
        np.save(path, values)
    else:
        height, width = values.shape
        path.write_bytes(b"Pf\n%d %d\n-1.0\n" % (width, height) + values[::-1].astype("<f4").tobytes())


def write_both(folder, shape=(40, 56)):
    """Write the same map for both frames; return the folder."""
    for name in "ab":
        write_map(folder / f"{name}.npy", metres(shape))
    return folder


@pytest.mark.parametrize("suffix", [".png", ".npy", ".pfm"])
@pytest.mark.parametrize("place", ["", "clip"])
def test_own_maps_are_read_in_metres_for_both_frames_and_completed(clip, tmp_path, suffix, place):
    for name, factor in (("a", 1), ("b", 1.05)):
        write_map(tmp_path / "maps" / place / f"{name}{suffix}", factor * metres())
    own = OwnDepth(tmp_path / "maps", clip, 70.0)
    depth = own.depth(clip["a"])
    for map_, measured, factor in zip(depth.maps, depth.measured, (1, 1.05), strict=True):
        assert map_.dtype == np.float32
        np.testing.assert_array_equal(measured, metres() > 0)
        np.testing.assert_allclose(map_[measured], (factor * metres())[measured], atol=6e-4)
        assert (map_ > 0).all()
    assert depth.camera.intrinsics(1) == (70.0, 70.0, 27.5, 19.5)
    assert depth.camera.rotation is None
    assert own.depth_files("a") == [tmp_path / "maps" / place / f"{name}{suffix}" for name in "ab"]


@pytest.mark.parametrize("shape", [(40, 56), (56, 40)])
def test_default_focal_length_is_the_longer_side_of_the_frames(tmp_path, shape):
    dataset = load_dataset("folder", pictures_of(tmp_path / "clip", "a.png", "b.png", shape=shape))
    maps = write_both(tmp_path / "maps", shape)
    assert OwnDepth(maps, dataset).depth(dataset["a"]).camera.focal == (56.0, 56.0)


def npy(values):
    buffer = io.BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


def png(dtype, *channels):
    return cv2.imencode(".png", np.full((40, 56, *channels), 100, dtype))[1].tobytes()


def endless_npy():
    """An NPY file that announces 10 billion values."""
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": "<f4", "fortran_order": False, "shape": (99999, 99999)})
    return buffer.getvalue()


NO_MAPS = {
    "pickled.npy": npy(np.array([[{"a": 1}]])),
    "huge.npy": endless_npy(),
    "headless.npy": b"\x93NUMPY\x01\x00\xff\xff{'descr': '<f4'",
    "cut.npy": npy(metres())[:-5],
    "long.npy": npy(metres()) + b"x",
    "channels.npy": npy(np.ones((40, 56, 3), np.float32)),
    "complex.npy": npy(np.ones((40, 56), np.complex64)),
    "empty.npy": b"",
    "colour.pfm": b"PF\n56 40\n-1.0\n" + b"\0" * 26880,
    "huge.pfm": b"Pf\n99999 99999\n-1.0\n",
    "cut.pfm": b"Pf\n56 40\n-1.0\n" + b"\0" * 100,
    "scaled.pfm": b"Pf\n56 40\n-2.5\n" + b"\0" * 8960,
    "bytes.png": png(np.uint8),
    "colour.png": png(np.uint16, 3),
    "cut.png": png(np.uint16)[:-40],
    "text.png": b"depth",
    "negative.npy": npy(-metres()),
    "holes.npy": npy(0 * metres()),
    "small.npy": npy(metres((40, 55))),
}


@pytest.mark.parametrize("name", NO_MAPS)
def test_file_that_is_not_a_depth_map_is_refused(clip, tmp_path, name):
    suffix = name.partition(".")[2]
    write_map(tmp_path / "maps" / f"a.{suffix}", metres())
    (tmp_path / "maps" / f"b.{suffix}").write_bytes(NO_MAPS[name])
    path = tmp_path / "maps" / f"b.{suffix}"
    of_content = name in ("negative.npy", "holes.npy", "small.npy")  # found when both maps are read
    culprit = f"{tmp_path / 'maps'}, sample 'a', frame 2" if of_content else path
    refusal(lambda: OwnDepth(tmp_path / "maps", clip).depth(clip["a"]), DataError, culprit)


def test_a_missing_map_is_named_before_anything_is_read(clip, tmp_path):
    write_map(tmp_path / "maps" / "a.npy", metres())
    refused = refusal(lambda: OwnDepth(tmp_path / "maps", clip).depth_files("a"), DataError, tmp_path / "maps")
    assert "b.png" in str(refused)


def test_maps_named_like_paths_of_windows_are_refused(clip, tmp_path):
    write_both(tmp_path / "maps")
    write_map(tmp_path / "maps" / "clip\\c.npy", metres())
    refusal(lambda: OwnDepth(tmp_path / "maps", clip), DataError, tmp_path / "maps" / "clip\\c.npy")


def test_frame_is_never_read_as_its_depth_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = load_dataset("folder", write_both(pictures_of(Path("clip"), "a.png", "b.png")))
    (tmp_path / "link").symlink_to(tmp_path / "clip")
    for folder in (Path("clip"), tmp_path / "clip", Path("link")):
        assert OwnDepth(folder, frames).depth_files("a") == [folder / "a.npy", folder / "b.npy"]


def test_one_map_for_two_frames_of_one_name_is_refused(tmp_path):
    frames = pictures_of(tmp_path / "clips", "one/a.png", "one/b.png", "two/a.png", "two/b.png")
    dataset, maps = load_dataset("folder", frames), write_both(tmp_path / "maps")
    own = OwnDepth(maps, dataset)
    assert own.depth_files("one/a")
    refusal(lambda: own.depth_files("two/a"), DataError, maps / "a.npy")
    write_both(maps / "one")
    write_both(maps / "two")
    assert OwnDepth(maps, dataset).depth_files("two/a") == [maps / "two" / f"{name}.npy" for name in "ab"]


@pytest.mark.parametrize(
    ("suffix", "unit", "per_metre", "warned"),
    [
        (".png", None, 1000, False),
        (".png", "mm", 1000, False),
        (".png", "m/5000", 5000, False),
        (".png", "m/256", 256, False),
        (".png", "cm", 100, False),
        (".npy", None, 1, False),
        (".npy", "mm", 1000, False),
        (".npy", "m/2.5", 2.5, False),
        (".pfm", "cm", 100, False),
        (".npy", None, 1000, True),
        (".png", "m", 1000, True),
        (".npy", "m/500000", 256, True),
    ],
)
def test_maps_are_read_in_the_stated_unit(clip, tmp_path, suffix, unit, per_metre, warned, recwarn):
    metres = np.linspace(2, 8, 40 * 56, dtype=np.float32).reshape(40, 56)
    for name in "ab":
        values = np.rint(metres * per_metre) / 1000 if suffix == ".png" else metres * per_metre
        write_map(tmp_path / "maps" / f"{name}{suffix}", values)
    depth = OwnDepth(tmp_path / "maps", clip, unit=unit).depth(clip["a"])
    assert len(recwarn) == warned
    if not warned:
        np.testing.assert_allclose(depth.maps[0], metres, atol=0.51 / per_metre, rtol=1e-6)


@pytest.mark.parametrize("unit", ["", "inch", "m/", "m/0", "m/-2", "m/1e3", "5000", "km", "m/nan", 1000])
def test_invalid_unit_is_refused(clip, tmp_path, unit):
    refusal(lambda: OwnDepth(tmp_path, clip, unit=unit), UsageError, "--depth-unit")


@pytest.mark.parametrize("focal", [0, -3, float("inf"), float("nan"), True, "far"])
def test_invalid_focal_length_is_refused(clip, tmp_path, focal):
    refusal(lambda: OwnDepth(tmp_path, clip, focal), UsageError, "--focal")


def test_the_digest_follows_maps_and_focal_length_and_nothing_else(clip, tmp_path):
    maps = write_both(tmp_path / "maps")
    before = OwnDepth(maps, clip).digest
    (maps / "c.npy").write_bytes(b"of another clip")
    assert OwnDepth(maps, clip).digest == before
    assert OwnDepth(maps, clip, 56.0).digest != before
    assert OwnDepth(maps, clip, unit="m/256").digest != before
    write_map(maps / "b.npy", metres() + 1)
    assert OwnDepth(maps, clip).digest != before
