"""Augmentation: parameters are distributed as in the original code, and the augmented flow still matches the augmented
images; colour jitter returns the same bytes as torchvision, which the original code uses."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy import stats

from robustflow.core.rng import Rng
from robustflow.testing import TexturePairs
from robustflow.training.augmentation.augment import apply_augmentation, draw_augmentation, draw_eraser, erase
from robustflow.training.augmentation.geometry import (
    Geometry,
    draw_geometry,
    scaled_size,
    warp_dense,
    warp_frame,
    warp_sparse,
)
from robustflow.training.augmentation.jitter import DENSE, OPERATIONS, SPARSE, Jitter, apply_jitter, draw_jitter
from robustflow.training.data.parts import OpenPart, Order
from robustflow.training.data.training_pairs import TrainingPairs
from robustflow.training.recipe import Part

pytestmark = pytest.mark.training

DRAWS = 2000
SHAPE, CROP = (436, 1024), (368, 768)
_ALPHA = 1e-4
"""Probability that samples from the correct distribution fail one of these tests; the seeds are fixed."""


def drawn(sparse: bool, flip: bool = True, log2_scale: tuple[float, float] = (-0.2, 0.6)) -> list[Geometry]:
    return [draw_geometry(Rng.of("draw", n), SHAPE, CROP, log2_scale, flip, sparse) for n in range(DRAWS)]


def share(count: int, probability: float) -> bool:
    return stats.binomtest(count, DRAWS, probability).pvalue > _ALPHA


def test_scales_of_dense_pairs():
    every = drawn(sparse=False)
    scaled = [one.scale for one in every if one.scale is not None]
    assert share(len(scaled), 0.8)
    least = max((CROP[0] + 8) / SHAPE[0], (CROP[1] + 8) / SHAPE[1])
    assert min(min(scale) for scale in scaled) == pytest.approx(least)
    stretched = np.log2([x / y for x, y in scaled if x > least and y > least])
    # Both axes are stretched by 2^U(-.2, .2) with probability 0.8, so the logarithm of their ratio
    # has a triangular distribution, or is 0.
    assert np.abs(stretched).max() <= 0.4
    unequal = stretched[np.abs(stretched) > 1e-12]
    assert stats.kstest(unequal, stats.triang(0.5, loc=-0.4, scale=0.8).cdf).pvalue > _ALPHA


def test_scales_of_sparse_pairs_are_uniform_powers_and_equal():
    # The crop is so small that no scale has to be limited.
    every = [draw_geometry(Rng.of("s", n), SHAPE, (96, 128), (-0.3, 0.5), True, True) for n in range(DRAWS)]
    scales = [one.scale for one in every if one.scale is not None]
    assert share(len(scales), 0.8)
    assert all(x == y for x, y in scales)
    assert stats.kstest(np.log2([x for x, _ in scales]), stats.uniform(-0.3, 0.8).cdf).pvalue > _ALPHA


def test_flips_have_their_stated_probabilities():
    dense, sparse, none = drawn(False), drawn(True), drawn(False, flip=False)
    assert share(sum(one.mirrored for one in dense), 0.5)
    assert share(sum(one.upside_down for one in dense), 0.1)
    assert share(sum(one.mirrored for one in sparse), 0.5)
    assert not any(one.upside_down for one in sparse)
    assert not any(one.mirrored or one.upside_down for one in none)


def test_sparse_crops_reach_the_borders_more_often():
    unscaled = [one for one in drawn(True) if one.scale is None]
    free = SHAPE[1] - CROP[1]
    at_the_left = sum(one.left == 0 for one in unscaled)
    assert stats.binomtest(at_the_left, len(unscaled), 51 / (free + 100)).pvalue > _ALPHA


def test_eraser_draws_as_often_and_as_large_as_stated():
    every = [draw_eraser(Rng.of("e", n), SHAPE) for n in range(DRAWS)]
    assert share(sum(bool(one) for one in every), 0.5)
    counts = [len(one) for one in every if one]
    assert stats.binomtest(counts.count(1), len(counts), 0.5).pvalue > _ALPHA
    sides = [side for one in every for rectangle in one for side in rectangle[2:]]
    assert (min(sides), max(sides)) == (50, 99)
    observed = np.bincount(sides, minlength=100)[50:]
    assert stats.chisquare(observed).pvalue > _ALPHA


def test_erasing_fills_with_the_mean_in_a_copy():
    frame = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    before = frame.copy()
    erased = erase(frame, ((70, 50, 60, 60),))
    assert (erased[50:, 70:] == frame.reshape(-1, 3).mean(axis=0).astype(np.uint8)).all()
    np.testing.assert_array_equal(erased[:50], frame[:50])
    np.testing.assert_array_equal(frame, before)


def test_the_share_of_asymmetric_jitter():
    dense = Part(data="sintel", augmentation="dense", log2_scale=(-0.2, 0.6), flip=True)
    sparse = dense.model_copy(update={"augmentation": "sparse"})
    of_dense = [len(draw_augmentation(Rng.of("j", n), dense, SHAPE, CROP).jitters) for n in range(DRAWS)]
    assert share(of_dense.count(2), 0.2)
    assert {len(draw_augmentation(Rng.of("j", n), sparse, SHAPE, CROP).jitters) for n in range(200)} == {1}


def test_frames_and_dense_flow_are_opencvs_resize():
    rng = np.random.default_rng(3)
    frame = rng.integers(0, 256, (40, 60, 3), dtype=np.uint8)
    flow = rng.normal(size=(40, 60, 2)).astype(np.float32)
    geometry = Geometry((1.3, 1.17), True, False, 5, 7)
    expected = cv2.resize(frame, None, fx=1.3, fy=1.17, interpolation=cv2.INTER_LINEAR)[:, ::-1][5:37, 7:55]
    np.testing.assert_array_equal(warp_frame(frame, geometry, (32, 48)), expected)
    resized = cv2.resize(flow, None, fx=1.3, fy=1.17, interpolation=cv2.INTER_LINEAR) * np.float32([1.3, 1.17])
    warped, valid = warp_dense(flow, np.ones((40, 60), bool), geometry, (32, 48))
    np.testing.assert_array_equal(warped, resized[:, ::-1][5:37, 7:55] * np.float32([-1, 1]))
    assert valid.all()


def test_sparse_points_move_as_in_a_naive_loop():
    rng = np.random.default_rng(4)
    flow = rng.normal(size=(30, 50, 2)).astype(np.float32)
    valid = rng.random((30, 50)) < 0.2
    geometry = Geometry((1.21, 1.21), False, False, 0, 0)
    width, height = scaled_size((30, 50), (1.21, 1.21))
    expected, known = np.zeros((height, width, 2), np.float32), np.zeros((height, width), bool)
    for y, x in np.argwhere(valid):
        row, column = round(y * 1.21), round(x * 1.21)
        if 0 < row < height and 0 < column < width:
            expected[row, column], known[row, column] = flow[y, x] * 1.21, True
    moved, mask = warp_sparse(flow, valid, geometry, (height, width))
    np.testing.assert_array_equal(mask, known)
    np.testing.assert_allclose(moved, expected, rtol=1e-6)


def test_a_dense_frame_smaller_than_the_crop_is_always_enlarged():
    for number in range(200):
        geometry = draw_geometry(Rng.of("small", number), (96, 128), CROP, (-0.4, 0.0), True, sparse=False)
        assert geometry.scale is not None
        width, height = scaled_size((96, 128), geometry.scale)
        assert 0 <= geometry.top <= height - CROP[0]
        assert 0 <= geometry.left <= width - CROP[1]


def test_a_sparse_pair_smaller_than_the_crop_gets_black_rows_without_ground_truth_before_it_is_scaled():
    """FlowFormer's crop of 432x960 is taller than KITTI's frames of 375x1242; here, both are a quarter of that."""
    shape, crop = (94, 310), (108, 240)
    part = Part(data="kitti2015", augmentation="sparse", log2_scale=(-0.2, 0.4), flip=False, eraser=False)
    every = [draw_augmentation(Rng.of("padded", n), part, shape, crop) for n in range(DRAWS)]
    scales = [one.geometry.scale for one in every]
    assert share(scales.count(None), 0.2)
    least = (crop[0] + 1) / crop[0]
    assert share(scales.count((least, least)), 0.8 * (0.2 + np.log2(least)) / 0.6)
    frame, flow = np.full((*shape, 3), 200, np.uint8), np.full((*shape, 2), 3, np.float32)
    for one in every[:40]:
        (first, second), moved, valid = apply_augmentation((frame, frame), flow, np.ones(shape, bool), one)
        assert first.shape == second.shape == (*crop, 3)
        scale = (one.geometry.scale or (1, 1))[0]
        end = round(shape[0] * scale) - one.geometry.top
        assert (second[: end - 2] > 0).all()
        assert valid[2 : end - 2].any()
        assert not second[end + 2 :].any()
        assert not valid[end + 2 :].any()
        assert np.allclose(moved[valid], 3 * scale)


def test_a_dense_frame_of_the_crops_size_is_its_own_crop_where_it_is_not_scaled():
    drawn = [draw_geometry(Rng.of("equal", n), CROP, CROP, (-0.1, 1.0), True, sparse=False) for n in range(DRAWS)]
    plain = [one for one in drawn if one.scale is None]
    assert share(len(plain), 0.2)
    assert {(one.top, one.left) for one in plain} == {(0, 0)}


@pytest.mark.parametrize("augmentation", ["dense", "sparse"])
def test_augmented_flow_matches_the_augmented_frames(augmentation):
    """The second frame, sampled along the flow, matches the first as closely after augmentation as before."""
    sample = TexturePairs(count=1, size=(200, 260), reach=6, seed=2).load("0")
    part = Part(data="sintel", augmentation=augmentation, log2_scale=(-0.1, 0.4), flip=True)
    assert sample.flow is not None
    assert sample.valid is not None
    assert sample.occluded is not None
    seen = sample.valid & ~sample.occluded
    before = warp_error(sample.frames[0], sample.frames[1], sample.flow, seen)
    for number in range(12):
        one = draw_augmentation(Rng.of("warp", number), part, (200, 260), (128, 160))
        frames = tuple(warp_frame(frame, one.geometry, one.crop) for frame in sample.frames)
        warp = warp_sparse if one.sparse else warp_dense
        flow, valid = warp(sample.flow, seen, one.geometry, one.crop)
        still = warp_error(frames[0], frames[1], np.zeros_like(flow), valid)
        assert warp_error(frames[0], frames[1], flow, valid) < max(3 * before + 2, 0.35 * still)


class UnknownFlow(TexturePairs):
    def load(self, key):
        sample = super().load(key)
        known = np.arange(sample.flow.shape[0])[:, None] + np.zeros(sample.flow.shape[1]) > 40
        return replace(sample, flow=np.where(known[..., None], sample.flow, np.float32(np.nan)), valid=known)


@pytest.mark.parametrize("augmentation", ["dense", "sparse"])
def test_unknown_flow_that_a_users_dataset_marks_with_nan_cannot_reach_the_loss(augmentation):
    dataset = UnknownFlow(count=4, size=(120, 160))
    part = Part(data="mine", augmentation=augmentation, log2_scale=(-0.1, 0.4), flip=True)
    pairs = TrainingPairs([OpenPart(part, dataset, tuple(dataset.keys()))], Order(4, 1, seed=0), (96, 128), seed=0)
    drawn = [pairs[position] for position in range(8)]
    assert all(np.isfinite(pair.flow).all() for pair in drawn)
    assert 0 < np.mean([pair.valid for pair in drawn]) < 0.9


def warp_error(first, second, flow, mask) -> float:
    """Mean absolute difference in grey levels between frame 1 and frame 2 warped along the flow."""
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    x, y = x + flow[..., 0], y + flow[..., 1]
    inside = mask & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    fetched = cv2.remap(second, x, y, cv2.INTER_LINEAR)
    return float(np.abs(fetched.astype(np.float64) - first)[inside].mean())


_factors = st.floats(0.5, 1.5)


def by_torchvision(image: np.ndarray, jitter: Jitter) -> np.ndarray:
    """Apply the operations in the order of the jitter; torchvision draws parameters and order itself."""
    torchvision = pytest.importorskip("torchvision.transforms.functional", reason="needs the torch extra")
    picture = Image.fromarray(image)
    for operation in jitter.order:
        picture = getattr(torchvision, f"adjust_{operation}")(picture, getattr(jitter, operation))
    return np.asarray(picture)


@settings(max_examples=60, deadline=None)
@given(
    brightness=_factors,
    contrast=_factors,
    saturation=_factors,
    hue=st.floats(-0.5, 0.5),
    order=st.permutations(OPERATIONS),
    seed=st.integers(0, 2**31),
    spread=st.sampled_from([256, 40, 3]),
)
def test_jitter_is_byte_identical_to_torchvision(brightness, contrast, saturation, hue, order, seed, spread):
    image = (np.random.default_rng(seed).integers(0, spread, (23, 31, 3)) + (256 - spread) // 2).astype(np.uint8)
    jitter = Jitter(brightness, contrast, saturation, hue, tuple(order))
    before = image.copy()
    np.testing.assert_array_equal(apply_jitter(image, jitter), by_torchvision(image, jitter))
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("strength", [DENSE, SPARSE])
def test_jitter_draws_its_stated_ranges(strength):
    drawn = [draw_jitter(Rng.of("test", number), strength) for number in range(3000)]
    for name in OPERATIONS:
        values, middle, most = [getattr(one, name) for one in drawn], float(name != "hue"), getattr(strength, name)
        assert min(values) >= middle - most
        assert max(values) <= middle + most
        counts = np.histogram(values, bins=10, range=(middle - most, middle + most))[0]
        assert np.square(counts - 300).sum() / 300 < 33.7  # chi-square, 9 degrees of freedom, p = 1e-4
    orders, counts = np.unique(["".join(one.order) for one in drawn], return_counts=True)
    assert len(orders) == 24
    assert np.square(counts - 125).sum() / 125 < 58.6  # 23 degrees of freedom, p = 5e-5
