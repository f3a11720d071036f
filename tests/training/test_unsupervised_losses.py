"""Transforms for training without labels agree with independently written formulas."""

import cv2
import numpy as np
import pytest
from scipy import ndimage, stats

from robustflow.core.rng import Rng
from robustflow.training.augmentation.augment import apply_look, augmented_whole, draw_augmentation, draw_look
from robustflow.training.data.parts import Order, open_part
from robustflow.training.data.training_pairs import TrainingPairs
from robustflow.training.recipe import Appearance, Objective, Part, Spatial, load_recipe

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.training.augmentation.affine import draw_moves, moved, moved_flow  # noqa: E402
from robustflow.training.losses.terms import dilated_warp  # noqa: E402
from robustflow.training.losses.unsupervised import OneWay, distillation  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


def images(count: int, height: int, width: int, seed: int = 0) -> torch.Tensor:
    """Smooth random images (count, 3, height, width) in 0..1."""
    noise = np.random.default_rng(seed).random((count, 3, height, width))
    smooth = ndimage.gaussian_filter(noise, (0, 0, 3, 3))
    low, high = smooth.min(), smooth.max()
    return torch.from_numpy((smooth - low) / (high - low)).float()


def test_dilated_warp_samples_the_uncropped_frame():
    """Sampling agrees with SciPy's sampling of the uncropped frame, for two frames of different sizes in one batch."""
    rng = np.random.default_rng(3)
    sizes = [(30, 40), (26, 44)]
    frames = [rng.random((3, *size)).astype(np.float32) for size in sizes]
    whole = torch.full((2, 3, 30, 44), 7.0)  # values outside a frame are meaningless
    for number, frame in enumerate(frames):
        whole[number, :, : frame.shape[1], : frame.shape[2]] = torch.from_numpy(frame)
    corners = torch.tensor([[5.0, 8.0], [20.0, 3.0]])
    flow = torch.from_numpy(rng.uniform(-25, 25, (2, 2, 12, 16)).astype(np.float32))
    found, inside = dilated_warp(whole, flow, corners, torch.tensor([[40.0, 30.0], [44.0, 26.0]]))
    y, x = np.mgrid[:12, :16]
    for number, frame in enumerate(frames):
        columns = x + flow[number, 0].numpy() + corners[number, 0].item()
        rows = y + flow[number, 1].numpy() + corners[number, 1].item()
        height, width = frame.shape[1:]
        mask = (columns >= 0) & (columns <= width - 1) & (rows >= 0) & (rows <= height - 1)
        assert 0.2 < mask.mean() < 0.9
        np.testing.assert_array_equal(inside[number, 0].numpy() > 0, mask)
        for channel in range(3):
            expected = ndimage.map_coordinates(frame[channel], [rows, columns], order=1, mode="nearest")
            np.testing.assert_allclose(found[number, channel].numpy()[mask], expected[mask], atol=2e-5)
        assert (found[number].numpy()[:, ~mask] == 0).all()


def test_the_distillation_moves_the_levels_and_not_the_teacher():
    torch.manual_seed(0)
    flow, level = torch.randn(1, 2, 16, 24, requires_grad=True), torch.randn(1, 2, 4, 6, requires_grad=True)
    image, seen = images(1, 16, 24), torch.ones(1, 1, 16, 24)
    distillation(OneWay(flow, [level], image, image, seen)).backward()
    assert flow.grad is None
    assert level.grad is not None
    assert level.grad.abs().sum() > 0


def test_brightflow_also_gets_unchanged_frames_without_their_border(chairs):
    objective = load_recipe("brightflow", "sintel").objective
    part = Part(data="flyingchairs", augmentation="dense", log2_scale=(0.0, 0.4), flip=True, eraser=False)
    opened = open_part(part, [chairs], labelled=False)

    def pairs(objective: Objective) -> TrainingPairs:
        return TrainingPairs([opened], Order(len(opened), 1, 0), (96, 128), 5, objective=objective)

    coloured = 0
    for number in range(6):
        pair = pairs(objective.model_copy(update={"border": 16}))[number]
        assert pair.whole is not None
        assert pair.plain is not None
        assert pair.changed is not None
        assert pair.whole.corner == pair.plain.corner
        assert pair.whole.frame1.shape == pair.plain.frame1.shape
        coloured += float(np.abs(pair.whole.frame1 - pair.plain.frame1).mean()) > 2
        assert np.corrcoef(pair.whole.frame2.ravel(), pair.plain.frame2.ravel())[0, 1] > 0.5  # no pixel has moved
        inner = pair.frame2.transpose(1, 2, 0)[16:-16, 16:-16].astype(np.uint8)
        expected = cv2.resize(inner, (128, 96), interpolation=cv2.INTER_LINEAR)
        np.testing.assert_array_equal(pair.changed[1].transpose(1, 2, 0), expected)
    assert coloured >= 5
    assert pairs(load_recipe("upflow", "unsupervised").objective)[0].plain is None


SPATIAL = Spatial(
    translation=0.2,
    zoom=(1.0, 1.5),
    squeeze=(0.86, 1.16),
    rotation=(-0.2, 0.2),
    relative_translation=0.015,
    relative_zoom=(0.985, 1.015),
    relative_rotation=(-0.015, 0.015),
    vertical=True,
)


def test_moved_frames_contain_no_outside_pixels_and_half_are_flipped():
    flipped = 0
    for number in range(300):
        moves = draw_moves(Rng.of("moves", number), SPATIAL, (48, 80))
        flipped += moves.first[0, 0] < 0
        for move in moves:
            assert moved(torch.ones(1, 1, 48, 80), [move]).min() > 0.999
    assert stats.binomtest(int(flipped), 300, 0.5).pvalue > 1e-4


def test_the_relative_rotation_is_the_originals_constant_unless_it_is_switched_off():
    def relative(settings: Spatial) -> list[float]:
        drawn = [draw_moves(Rng.of("angle", number), settings, (200, 200)) for number in range(60)]
        steps = [one.second @ np.linalg.inv(one.first) for one in drawn]
        return [float(np.arctan2(step[0, 1], step[1, 1])) for step in steps]

    plain = Spatial(horizontal=False, zoom=(1.2, 1.4))
    assert relative(plain) == pytest.approx([-0.01] * 60, abs=1e-9)
    angles = relative(plain.model_copy(update={"constant_rotation": False}))
    assert stats.kstest(angles, stats.uniform(-0.01, 0.02).cdf).pvalue > 1e-4


@pytest.mark.parametrize("number", range(4))
def test_moved_flow_matches_the_moved_frames(number):
    """The moved second frame, sampled along the moved flow, equals the moved first frame."""
    height, width = 96, 128
    frame = images(1, height + 40, width + 40, number)
    first, second = frame[..., 20 : 20 + height, 20 : 20 + width], frame[..., 17 : 17 + height, 24 : 24 + width]
    flow = torch.empty(1, 2, height, width)
    flow[:, 0], flow[:, 1] = -4.0, 3.0  # first(x) = second(x + flow)
    moves = [draw_moves(Rng.of("true", number), SPATIAL, (height, width))]
    moved1, moved2 = moved(first, [moves[0].first]), moved(second, [moves[0].second])
    whole = torch.tensor([[float(width), float(height)]])
    found, inside = dilated_warp(moved2, moved_flow(flow, moves), torch.zeros(1, 2), whole)
    still, _ = dilated_warp(moved2, torch.zeros_like(flow), torch.zeros(1, 2), whole)
    inside[..., :2, :] = inside[..., -2:, :] = inside[..., :2] = inside[..., -2:] = 0
    off = ((found - moved1).abs() * inside).sum() / inside.sum()
    off_still = ((still - moved1).abs() * inside).sum() / inside.sum()
    assert off < 0.1 * off_still


def test_appearance_change_is_the_same_in_both_frames_and_leaves_the_input_unchanged():
    frame = np.random.default_rng(0).integers(60, 180, (24, 32, 3), dtype=np.uint8)
    before = frame.copy()
    appearances = [draw_look(Rng.of("look", number), Appearance()) for number in range(400)]
    assert stats.binomtest(sum(look.blur > 0 for look in appearances), 400, 0.5).pvalue > 1e-4
    assert stats.kstest([look.blur for look in appearances if look.blur], stats.uniform(0, 3).cdf).pvalue > 1e-4
    assert stats.kstest([look.jitter.brightness for look in appearances], stats.uniform(0.5, 1).cdf).pvalue > 1e-4
    assert {look.gamma for look in appearances} == {1.0}
    for look in appearances[:5]:
        np.testing.assert_array_equal(apply_look(frame, look), apply_look(frame, look))
    np.testing.assert_array_equal(frame, before)
    sharp = next(look for look in appearances if not look.blur)
    expected = np.floor(np.clip(frame.astype(np.float32) * np.float32(sharp.jitter.brightness), 0, 255))
    np.testing.assert_array_equal(apply_look(frame, sharp), expected)
    gamma = draw_look(Rng.of("gamma"), Appearance(brightness=0, blur=0, gamma=(2.0, 2.0)))
    np.testing.assert_array_equal(apply_look(frame, gamma), np.rint(255 * (frame / 255) ** 2))


@pytest.mark.parametrize(("augmentation", "margin"), [("stretched", 0), ("cropped", 8)])
def test_stretched_and_cropped_frames_have_the_crop_size_and_flips(augmentation, margin):
    part = Part(data="kitti_multiview", augmentation=augmentation, flip=True, margin=margin)
    shape, crop = (120, 200), (64, 128)
    drawn = [draw_augmentation(Rng.of("plain", number), part, shape, crop) for number in range(400)]
    for flag in ([one.swapped for one in drawn], [one.geometry.mirrored for one in drawn]):
        assert stats.binomtest(sum(flag), 400, 0.5).pvalue > 1e-4
    frames = tuple(np.random.default_rng(n).integers(0, 255, (*shape, 3), dtype=np.uint8) for n in (0, 1))
    if augmentation == "stretched":
        assert {frame.shape for one in drawn[:4] for frame in augmented_whole(frames, one)} == {(*crop, 3)}
        return
    assert min(one.geometry.left for one in drawn) == min(one.geometry.top for one in drawn) == margin
    assert max(one.geometry.left for one in drawn) == 200 - 128 - margin
    swapped = next(one for one in drawn if one.swapped and not one.geometry.mirrored)
    np.testing.assert_array_equal(augmented_whole(frames, swapped)[0], frames[1])
