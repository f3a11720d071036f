"""A flow in a wrong format, of a model or as ground truth, is recognised from the frames; a right one, or one without
evidence, is never accused.
"""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.core.types import Sample
from robustflow.data.datasets import load_dataset
from robustflow.media.flow import read_flow
from robustflow.media.images import read_image
from robustflow.metrics.photometric import UNIT, Misread, Reading, _judged, misread, misread_truth

from ..shared_data import shared_folder

WRONG = {
    "swapped": (lambda flow, size: flow[..., ::-1], Reading(swapped=True)),
    "negated": (lambda flow, size: -flow, Reading(signs=(-1, -1))),
    "v up": (lambda flow, size: flow * np.float32([1, -1]), Reading(signs=(1, -1))),
    "swapped and negated": (lambda flow, size: -flow[..., ::-1], Reading(True, (-1, -1))),
    "divided by the size": (lambda flow, size: flow / size, Reading(unit="frame")),
    "-1 to 1": (lambda flow, size: flow / (size / 2), Reading(unit="half frame")),
    "x 0.55": (lambda flow, size: flow * np.float32(0.55), Reading(factor=2.0)),
    "an eighth": (lambda flow, size: flow / 8, Reading(factor=8.0)),
    "doubled": (lambda flow, size: flow * 2, Reading(factor=0.5)),
    "8 times": (lambda flow, size: flow * 8, Reading(factor=0.125)),
}


def texture(height, width, seed=0):
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (height // 6, width // 6, 3), np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def rotation(height=120, width=160, radians=0.06):
    """Two frames of a rotating texture and the true flow, whose vectors point in all directions."""
    frame2 = texture(height, width)
    rows, columns = np.indices((height, width), np.float32)
    y, x = rows - height / 2, columns - width / 2
    flow = np.stack([np.cos(radians) * x - np.sin(radians) * y - x, np.sin(radians) * x + np.cos(radians) * y - y], -1)
    flow = (flow + np.float32([3, 1])).astype(np.float32)
    frame1 = cv2.remap(frame2, columns + flow[..., 0], rows + flow[..., 1], cv2.INTER_LINEAR, borderMode=0)
    return frame1, frame2, flow


def wrong_flow(flow, name):
    changed = WRONG[name][0](flow, np.float32([flow.shape[1], flow.shape[0]]))
    return np.ascontiguousarray(changed, np.float32)


def test_right_flow_of_a_rotation_is_not_accused():
    assert misread([rotation()]) is None


@pytest.mark.parametrize("name", WRONG)
def test_wrong_format_of_the_flow_of_a_rotation_is_named(name):
    frame1, frame2, flow = rotation()
    found = misread([(frame1, frame2, wrong_flow(flow, name))])
    assert found is not None
    assert found.reading == WRONG[name][1]
    assert found.error < 0.7 * found.given


def test_format_named_for_part_of_the_pixels_is_named_too():
    frame1, frame2, flow = rotation()
    flow = -flow
    flow[::2, 1::2] = np.nan
    assert misread([(frame1, frame2, flow)]).reading == Reading(signs=(-1, -1))


def test_large_frames_are_judged_on_some_of_their_rows():
    frame1, frame2, flow = rotation(1200, 1600, radians=0.01)
    assert misread([(frame1, frame2, flow)]) is None
    assert misread([(frame1, frame2, -flow)]).reading == Reading(signs=(-1, -1))


@pytest.mark.parametrize(
    "pair",
    [
        pytest.param(lambda one, two, flow: (one, one, -flow * np.float32(0.01)), id="still"),
        pytest.param(lambda one, two, flow: (0 * one + 90, 0 * two + 90, -flow), id="no texture"),
        pytest.param(lambda one, two, flow: (one, two, 0 * flow), id="zero flow"),
        pytest.param(lambda one, two, flow: (one, two, 0 * flow + np.float32([-3, -1])), id="constant flow"),
        pytest.param(lambda one, two, flow: (one, two, flow[::-1, ::-1].copy()), id="unrelated flow"),
        pytest.param(lambda one, two, flow: (one, two, flow * np.float32(np.nan)), id="no finite flow"),
        pytest.param(lambda one, two, flow: (one, two, flow + np.float32(1e6)), id="flow out of the frame"),
        pytest.param(lambda one, two, flow: (one, two, flow * np.float32(0.9)), id="slightly short"),
    ],
)
def test_flow_without_evidence_of_a_wrong_format_is_not_accused(pair):
    assert misread([pair(*rotation())]) is None


def test_constant_flows_are_judged_by_several_pairs():
    frames = texture(140, 180)
    moves = [(3, -2), (-2, -3)]
    pairs = [(frames[10:130, 10:170].copy(), frames[10 - v : 130 - v, 10 - u : 170 - u].copy(), u, v) for u, v in moves]
    flows = [np.full((120, 160, 2), (v, u), np.float32) for *_, u, v in pairs]
    assert misread([(one, two, flow) for (one, two, *_), flow in zip(pairs, flows, strict=True)]).reading.swapped
    same = np.full((120, 160, 2), (-2, 3), np.float32)
    assert misread([(one, two, same) for one, two, *_ in pairs]) is None


@pytest.fixture(scope="module")
def kitti_pair():
    """A KITTI pair with DIS's flow, which its ground truth also covers in part."""
    folder = shared_folder("data", "kitti2015", "training")
    frames = [cv2.imread(str(folder / f"image_2/000010_{n}.png"))[..., ::-1].copy() for n in (10, 11)]
    truth, valid = read_flow(folder / "flow_occ/000010_10.png")
    truth[~valid] = np.nan
    return *frames, rf.load_model("dis").predict(*frames), truth


@pytest.mark.parametrize("name", WRONG)
def test_wrong_formats_on_a_real_pair_are_named(kitti_pair, name):
    frame1, frame2, *flows = kitti_pair
    for flow in flows:
        assert misread([(frame1, frame2, wrong_flow(flow, name))]).reading == WRONG[name][1]


def test_right_flows_on_a_real_pair_are_not_accused(kitti_pair):
    frame1, frame2, *flows = kitti_pair
    assert [misread([(frame1, frame2, flow)]) for flow in flows] == [None, None]


def backward(flow, valid):
    """The flow from frame 2 to frame 1, at the pixels of frame 2."""
    out = np.full_like(flow, np.nan)
    rows, columns = np.nonzero(valid)
    vectors = flow[rows, columns]
    to = np.rint(np.stack([columns, rows], -1) + vectors).astype(int)
    inside = ((to >= 0) & (to < flow.shape[1::-1])).all(axis=1)
    out[to[inside, 1], to[inside, 0]] = -vectors[inside]
    return out


WRONG_TRUTH = WRONG | {
    "x 1.5": (lambda flow, size: flow * np.float32(1.5), Reading(factor=2**-0.5)),
    "KITTI's 64": (lambda flow, size: flow * 64, Reading(factor=1 / 64)),
    "v up, divided by the size": (lambda flow, size: flow / size * [1, -1], Reading(signs=(1, -1), unit="frame")),
    "rows from the bottom": (lambda flow, size: flow[::-1], Reading(flipped="rows")),
    "a mirrored frame": (lambda flow, size: flow[::-1] * [1, -1], Reading(signs=(1, -1), flipped="rows")),
    "mirrored columns": (lambda flow, size: flow[:, ::-1] * [-1, 1], Reading(signs=(-1, 1), flipped="columns")),
}


@pytest.mark.parametrize(
    ("root", "count", "truths", "frames"),
    [
        ("kitti2012/training", 8, "flow_*/*.png", "image_0/{key}_1{n}.png"),
        ("kitti2012_colour_noc_only/training", 1, "flow_*/*.png", "colored_0/{key}_1{n}.png"),
        ("kitti2015/training", 6, "flow_*/*.png", "image_2/{key}_1{n}.png"),
        ("kitti2015_noc_only/training", 1, "flow_*/*.png", "image_2/{key}_1{n}.png"),
        ("middlebury", 4, "other-gt-flow/*/*.flo", "other-data/{scene}/frame1{n}.png"),
        ("sintel/training", 1, "flow/*/*.flo", "unlabelled_pass/{scene}/frame_000{m}.png"),
        ("flyingchairs/data", 1, "*.flo", "00005_img{m}.ppm"),
    ],
)
def test_truth_of_real_pairs_is_not_accused_and_its_wrong_formats_are(root, count, truths, frames):
    folder = shared_folder("data", *root.split("/"))
    paths = sorted(folder.glob(truths))
    assert len(paths) == count
    for place, path in enumerate(paths):
        names = [frames.format(key=path.stem[:6], scene=path.parent.name, n=n, m=n + 1) for n in (0, 1)]
        pair = [read_image(folder / name) for name in names]
        flow, valid = read_flow(path)
        assert misread_truth(Sample("a", tuple(pair), flow, valid)) is None
        flow[~valid] = np.nan
        for name in WRONG_TRUTH if place == 0 else ("doubled", "rows from the bottom"):
            changed = np.ascontiguousarray(WRONG_TRUTH[name][0](flow, np.float32(flow.shape[1::-1])), np.float32)
            result = misread([(*pair, changed)], truth=True)
            assert result is not None, (path, name)
            # elsewhere, a simpler reading may fit about as well
            assert result.reading == WRONG_TRUTH[name][1] or root not in ("kitti2015/training", "sintel/training")
        assert misread([(*pair, backward(flow, valid))], truth=True).reading == Reading(signs=(-1, -1))


@pytest.mark.parametrize("dataset", [load_dataset("shapes", pairs=8, size="128x160"), load_dataset("motorcycle")])
def test_exact_truth_is_not_accused(dataset):
    assert [misread_truth(sample) for sample in dataset] == [None] * len(dataset)


@pytest.mark.parametrize("move", [(0, 0), (3, 0), (0, -2), (-4, 5)])
@pytest.mark.parametrize("noise", [0, 6, 25])
def test_truth_with_one_vector_is_judged(move, noise):
    (u, v), frames, rng = move, texture(140, 180), np.random.default_rng(0)
    pair = [np.ascontiguousarray(frames[y : y + 120, x : x + 160]) for x, y in ((10, 10), (10 - u, 10 - v))]
    pair = [np.clip(frame + rng.normal(0, noise, frame.shape), 0, 255).astype(np.uint8) for frame in pair]
    flow = np.full((120, 160, 2), move, np.float32)
    assert misread([(*pair, flow)], truth=True) is None
    if noise < 10 and any(move):
        for changed in (2 * flow, -flow, flow[..., ::-1], flow / np.float32([160, 120])):
            assert misread([(*pair, np.ascontiguousarray(changed))], truth=True) is not None


@pytest.mark.parametrize(("count", "accused"), [(255, False), (256, True)])
def test_truth_of_few_pixels_is_no_evidence(count, accused):
    frame1, frame2, flow = rotation(480, 640, radians=0.01)
    known = np.zeros((480, 640), bool)
    known[200:280:4, 300:340:2].flat[:count] = True
    truth = np.where(known[..., None], -flow, np.float32(np.nan))
    assert (misread([(frame1, frame2, truth)], truth=True) is not None) is accused


@pytest.mark.parametrize(("inside", "accused"), [(0.45, False), (0.55, True)])
def test_reading_that_leaves_the_frame_is_no_evidence(inside, accused):
    """Where the exposure changes, a far region can fit better by chance."""
    frames = texture(120, 480)
    move = round(240 * (1 - inside))
    pair = frames[:, :240].copy(), np.ascontiguousarray(np.roll(frames, move, axis=1)[:, :240])
    flow = np.zeros((120, 240, 2), np.float32)
    flow[..., 0] = move / 4
    assert (misread([(*pair, flow)], truth=True) is not None) is accused


ONE, TWO = Reading(swapped=True), Reading(swapped=True, factor=2.0)


@pytest.mark.parametrize(
    ("reading", "constant", "error", "given", "still", "accused"),
    [
        *((ONE, False, 69, 100, 100, True), (ONE, False, 71, 100, 100, False)),
        *((ONE, False, 41, 100, 60, True), (ONE, False, 43, 100, 60, False)),
        *((TWO, False, 49, 100, 100, True), (TWO, False, 51, 100, 100, False)),
        *((ONE, True, 29, 100, 100, True), (ONE, True, 31, 100, 100, False)),
        *((ONE, False, 0.48, 1, 1, True), (ONE, False, 0.52, 1, 1, False)),
    ],
)
def test_reading_is_clearly_better_below_a_share_of_the_error(reading, constant, error, given, still, accused):
    levels = (np.full(1000, round(value * UNIT), np.int32) for value in (error, given, still))
    of_reading, errors, of_still = levels
    pair = SimpleNamespace(read=lambda _: of_reading, given=errors, still=of_still, known=1000, outside=False)
    assert (_judged([pair], reading, constant) is not None) is accused


@pytest.mark.parametrize(
    ("known", "both", "inside", "accused"),
    [
        *((1000, 256, 1000, True), (1000, 255, 1000, False)),
        *((10_000, 510, 10_000, True), (10_000, 490, 10_000, False)),
        *((1000, 500, 500, True), (1000, 490, 490, False), (1000, 510, 510, True)),
    ],
)
def test_a_reading_is_judged_by_enough_pixels_inside_the_frame(known, both, inside, accused):
    of_reading = np.where(np.arange(known) < inside, 0, -1).astype(np.int32)
    errors = np.where(np.arange(known) < both, 100 * UNIT, -1).astype(np.int32)
    pair = SimpleNamespace(read=lambda _: of_reading, given=errors, still=np.abs(errors), known=known, outside=False)
    assert (_judged([pair], ONE, False) is not None) is accused


@pytest.mark.parametrize(("worse", "named"), [(1.24, ONE), (1.26, Reading(factor=8.0))])
def test_the_simplest_of_about_equal_readings_is_named(monkeypatch, worse, named):
    better = {ONE: Misread(ONE, 10 * worse, 100), Reading(factor=8.0): Misread(Reading(factor=8.0), 10, 100)}
    monkeypatch.setitem(misread.__globals__, "_judged", lambda pairs, reading, constant: better.get(reading))
    assert misread([rotation()]).reading == named


@pytest.mark.parametrize(("spread", "varied"), [(0.048, False), (0.052, True)])
def test_vectors_vary_from_a_twentieth_of_their_length(monkeypatch, spread, varied):
    seen = []
    monkeypatch.setitem(misread.__globals__, "_judged", lambda pairs, reading, constant: seen.append(constant))
    frame1, frame2, flow = rotation()
    flow[...] = 0
    flow[..., 0] = 10 * (1 + spread * (-1.0) ** np.arange(flow.shape[1]))
    misread([(frame1, frame2, flow)], truth=True)
    assert set(seen) == {not varied}
