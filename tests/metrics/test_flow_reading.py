"""A flow in a wrong format is recognised from the frames; a right one, or one without evidence, is never accused."""

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.media.flow import read_flow
from robustflow.metrics.photometric import Reading, misread

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
