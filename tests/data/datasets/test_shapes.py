"""Flying shapes have exact flow, occlusion that agrees with a brute-force test, and the same bytes on every machine."""

import hashlib
import pickle

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from robustflow.core.errors import UsageError
from robustflow.core.rng import Rng
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.shapes.dataset import FlyingShapes
from robustflow.data.datasets.shapes.render import colours_at, flow_at, render_pair
from robustflow.data.datasets.shapes.scene import at_time, backward, draw_scene, forward, from_time, inset
from robustflow.data.datasets.shapes.textures import procedural_textures
from tests.refusals import refusal

SHAPE = (72, 96)


def scene(number):
    return draw_scene(Rng.of("test", number), SHAPE, 1.0, procedural_textures(0, "test"))


def row_times(which, readout, points):
    """Times at which the rows that contain the points are read out."""
    return which + readout * ((points[:, 1] + 0.5) / SHAPE[0] - 0.5)


def insets(scene, points, times):
    """Distance of points from the border of each layer at their times, (layers, points), positive inside."""
    return np.array(
        [
            [inset(outline, *from_time(motion, t, *point)) for point, t in zip(points, times, strict=True)]
            for outline, motion in zip(scene.outlines, scene.motions, strict=True)
        ]
    )


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.tuples(st.floats(-50, 150), st.floats(-50, 150)), st.floats(-0.5, 1.5))
def test_motion_and_its_inverse_cancel(number, point, time):
    for motion in scene(number).motions[-3:]:
        np.testing.assert_allclose(backward(motion, *forward(motion, *point)), point, atol=1e-9)
        np.testing.assert_allclose(from_time(motion, time, *at_time(motion, time, *point)), point, atol=1e-9)
        assert at_time(motion, 0.0, *point) == from_time(motion, 0.0, *point) == point
        assert at_time(motion, 1.0, *point) == forward(motion, *point)
        assert from_time(motion, 1.0, *point) == backward(motion, *point)


@pytest.mark.parametrize(("number", "readout"), [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0), (0, 0.4), (1, 1.0)])
def test_the_flow_leads_to_the_same_colour_to_rounding(number, readout):
    drawn = scene(number)
    points = np.random.default_rng(number).uniform(0, 1, (4000, 2)) * (SHAPE[1] - 1, SHAPE[0] - 1)
    flow, occluded = flow_at(drawn, points, readout)
    targets = points + flow
    difference = np.abs(colours_at(drawn, points, 0, readout) - colours_at(drawn, targets, 1, readout)).max(axis=1)
    here = insets(drawn, points, row_times(0, readout, points))
    there = insets(drawn, targets, row_times(1, readout, targets))
    sharp = (np.minimum(np.abs(here), np.abs(there)) > 0.6).all(axis=0)  # no border of any layer nearby
    assert (sharp & ~occluded).mean() > 0.4
    assert difference[sharp & ~occluded].max() < 1e-7
    assert np.abs(flow).max() > 1


@pytest.mark.parametrize(("number", "readout"), [(0, 0.0), (1, 0.0), (0, 1.0)])
def test_occlusion_equals_that_of_tracked_points(number, readout):
    """Points in and around every layer, four per pixel along each axis, are moved to frame 2; a point is covered if it
    lies among the points of a layer above. The test does not use the inverse of a motion, and finds the row that reads
    a point by iteration.
    """
    drawn = scene(number)
    rng = np.random.default_rng(number)
    points = rng.uniform(0, 1, (400, 2)) * (SHAPE[1] - 1, SHAPE[0] - 1)
    flow, occluded = flow_at(drawn, points, readout)
    own = (insets(drawn, points, row_times(0, readout, points)) > 0).argmax(axis=0)
    wide = 30
    grid = np.meshgrid(np.arange(-wide, SHAPE[1] + wide, 0.25), np.arange(-wide, SHAPE[0] + wide, 0.25))
    fine = np.stack(grid, axis=-1).reshape(-1, 2)
    expected, doubtful = np.zeros(len(points), bool), np.zeros(len(points), bool)
    for layer in range(len(drawn.outlines) - 1):
        outline, motion = drawn.outlines[layer], drawn.motions[layer]
        near = fine[np.hypot(*(fine - outline[:2]).T) < motion[20] + 1]
        covers = np.array([inset(outline, *point) > 0 for point in near], bool)
        if not covers.any():
            continue
        moved = start = np.array([forward(motion, *point) for point in near])
        for _ in range(20):
            moved = near + row_times(1, readout, moved)[:, None] * (start - near)
        inner, outer = (cKDTree(moved[which]).query(points + flow)[0] for which in (covers, ~covers))
        above = own > layer
        expected |= above & (inner < outer) & (inner < 1)
        doubtful |= above & (np.abs(inner - outer) < 0.3) & (inner < 1)
    target = points + flow
    expected |= ~((target >= 0) & (target <= (SHAPE[1] - 1, SHAPE[0] - 1))).all(axis=1)
    assert doubtful.mean() < 0.05
    np.testing.assert_array_equal(occluded[~doubtful], expected[~doubtful])
    assert 0 < expected.mean() < 0.9


@pytest.mark.parametrize("readout", [0.2, 1.0])
def test_a_rolling_shutter_shows_the_same_point_of_the_scene_at_both_ends_of_its_flow(readout):
    """The flow is correct to 1e-9 pixels, according to the inverse of the motion at the times of the two rows."""
    drawn = scene(5)
    points = np.random.default_rng(5).uniform(0, 1, (500, 2)) * (SHAPE[1] - 1, SHAPE[0] - 1)
    flow, occluded = flow_at(drawn, points, readout)
    points, targets = points[~occluded], (points + flow)[~occluded]
    times = row_times(0, readout, points), row_times(1, readout, targets)
    own = (insets(drawn, points, times[0]) > 0).argmax(axis=0)
    for point, target, begin, end, layer in zip(points, targets, *times, own, strict=True):
        motion = drawn.motions[layer]
        np.testing.assert_allclose(from_time(motion, begin, *point), from_time(motion, end, *target), atol=1e-9)


def test_a_rolling_shutter_bends_what_moves_and_a_global_one_takes_all_rows_at_once():
    drawn = scene(6)
    (first, second), flow, occluded = render_pair(drawn, 0.5)
    height, width = SHAPE
    for row in (0, 31, height - 1):
        points = np.stack([np.arange(width, dtype=float), np.full(width, float(row))], axis=-1)
        time = 0.5 * ((row + 0.5) / height - 0.5)
        for frame, which in ((first, 0), (second, 1)):
            np.testing.assert_array_equal(frame[row], np.rint(colours_at(drawn, points, which + time)))
    still, moved = render_pair(drawn), render_pair(drawn, 0.0)
    assert (first != still[0][0]).mean() > 0.3
    for one, two in zip((*still[0], *still[1:]), (*moved[0], *moved[1:]), strict=True):
        np.testing.assert_array_equal(one, two)
    assert np.abs(flow - still[1]).max() > 0.5
    assert (occluded != still[2]).any()


def test_motion_faster_than_the_readout_is_occluded_and_its_flow_stays_short():
    drawn = scene(7)
    drawn.motions[:, 2:4] = 0.0, 1.3 * SHAPE[0]
    drawn.motions[:, 22:24] = drawn.motions[:, :2] + drawn.motions[:, 2:4]
    points = np.random.default_rng(7).uniform(0, 1, (500, 2)) * (SHAPE[1] - 1, SHAPE[0] - 1)
    for readout in (0.7, 1 / 1.3, 0.8, 1.0):
        flow, occluded = flow_at(drawn, points, readout)
        assert np.abs(flow).max() < 4 * SHAPE[0]
        rows = (points + flow)[:, 1]
        assert occluded[(rows < 0) | (rows > SHAPE[0] - 1)].all()


def test_a_pair_is_a_function_of_its_options():
    few, many = FlyingShapes(3, "40x50"), FlyingShapes(1000, "40x50")
    for other in (many, pickle.loads(pickle.dumps(few))):
        for one, two in zip(few.load("000002").frames, other.load("000002").frames, strict=True):
            np.testing.assert_array_equal(one, two)
    digest = hashlib.sha256(b"".join(frame.tobytes() for frame in few.load("000002").frames)).hexdigest()[:16]
    assert digest == "f16de49dcf4ed3af"
    assert (few.load("000002").flow != FlyingShapes(3, "40x50", readout=0.3).load("000002").flow).any()
    for other in (FlyingShapes(3, "40x50", seed=1), FlyingShapes(3, "40x50", split="train")):
        assert (few.load("000002").frames[0] != other.load("000002").frames[0]).mean() > 0.5


def test_motion_scales_the_flow_and_most_of_it_is_short():
    lengths = {
        motion: np.array(
            [np.hypot(*sample.flow.reshape(-1, 2).T).mean() for sample in FlyingShapes(40, "96x128", motion=motion)]
        )
        for motion in (0.0, 1.0, 2.0)
    }
    assert 1.5 * lengths[0.0].mean() < lengths[1.0].mean() < lengths[2.0].mean() / 1.3
    assert np.median(lengths[1.0]) < lengths[1.0].mean() < 0.2 * 96


def test_own_images_are_used_as_textures(tmp_path):
    rng = np.random.default_rng(0)
    for index in range(2):
        cv2.imwrite(str(tmp_path / f"{index}.png"), rng.integers(0, 255, (60 + index, 90, 3)).astype(np.uint8))
    own = FlyingShapes(2, "32x48", textures=str(tmp_path))
    assert len(own.files("000000")) == 2
    assert (own.load("000000").frames[0] != FlyingShapes(2, "32x48").load("000000").frames[0]).any()


@pytest.mark.parametrize(
    "options",
    [{"pairs": 0}, {"pairs": True}, {"size": "8x9"}, {"size": "wide"}, {"split": "val"}, {"motion": -1}, {"seed": 0.5},
     {"textures": "nowhere"}, {"readout": 1.1}, {"readout": True}],
)  # fmt: skip
def test_invalid_options_of_shapes_are_refused(options):
    with pytest.raises(UsageError) as caught:
        load_dataset("shapes", **options)
    assert caught.value.culprit in (*options, *map(str, options.values()))


@pytest.mark.parametrize("key", ["1", "000003", "-00001", "1e3", "00000x", "0000001"])
def test_unknown_keys_of_shapes_are_refused(key):
    refusal(lambda: FlyingShapes(3).load(key), UsageError, key)
