import cv2
import numpy as np
import pytest

from robustflow.metrics.photometric import UNIT, photometric

from ..shared_data import shared_folder


def pair(seed=0, shape=(40, 60), shift=(3, -2)):
    """Two windows of a smooth texture, whose true flow is `shift`."""
    u, v = shift
    coarse = np.random.default_rng(seed).integers(0, 256, (12, 16, 3), np.uint8)
    texture = cv2.resize(coarse, (shape[1] + 16, shape[0] + 16), interpolation=cv2.INTER_CUBIC)
    first, second = texture[8:, 8:], texture[8 - v :, 8 - u :]
    return tuple(np.ascontiguousarray(each[: shape[0], : shape[1]]) for each in (first, second))


def constant(shape, u, v):
    return np.full((*shape, 2), (u, v), np.float32)


def test_true_flow_explains_the_pair_and_zero_flow_does_not():
    frame1, frame2 = pair()
    flow = constant((40, 60), 3, -2)
    n, total, still, errors = photometric(frame1, frame2, flow)
    assert (n, total) == (57 * 38, 0.0)
    assert still > 5 * n
    assert (errors[2:, :57] == 0).all()
    assert (errors[:2] == -1).all()
    assert (errors[:, 57:] == -1).all()


def test_photometric_map_adds_up_to_the_sum():
    frame1, frame2 = pair()
    flow = np.random.default_rng(1).normal(0, 6, (40, 60, 2)).astype(np.float32)
    n, total, _, errors = photometric(frame1, frame2, flow)
    assert n == (errors >= 0).sum() < errors.size
    assert total == errors[errors >= 0].sum(dtype=np.int64) / UNIT


def test_values_equal_opencv_remap_on_a_real_pair():
    folder = shared_folder("data", "middlebury")
    frames = [cv2.imread(str(folder / f"other-data/Hydrangea/frame{n}.png")) for n in (10, 11)]
    flow = cv2.DISOpticalFlow.create(2).calc(*(cv2.cvtColor(each, cv2.COLOR_BGR2GRAY) for each in frames), None)
    grey1, grey2 = (frame.astype(np.float32).mean(axis=2) for frame in frames)
    columns, rows = np.meshgrid(np.arange(grey1.shape[1]), np.arange(grey1.shape[0]))
    map_x, map_y = (columns + flow[..., 0]).astype(np.float32), (rows + flow[..., 1]).astype(np.float32)
    inside = (map_x >= 0) & (map_x <= grey1.shape[1] - 1) & (map_y >= 0) & (map_y <= grey1.shape[0] - 1)
    expected = np.abs(grey1 - cv2.remap(grey2, map_x, map_y, cv2.INTER_LINEAR))[inside]
    n, total, _, _ = photometric(*frames, flow)
    assert n == inside.sum()
    assert total / n == pytest.approx(expected.mean(), rel=2e-3)  # remap rounds targets to 1/32 px
