"""Losses without labels equal their formulas, written out in NumPy in double precision."""

import numpy as np
import pytest
from scipy import ndimage

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.training.losses import terms as loss_terms  # noqa: E402
from robustflow.training.losses import unsupervised as brightflow  # noqa: E402
from robustflow.training.losses.terms import (  # noqa: E402
    charbonnier,
    coverage,
    robust_smoothness,
    seen_by_check,
    seen_by_splat,
    smoothness,
)
from robustflow.training.losses.unsupervised import (  # noqa: E402
    OneWay,
    UnsupervisedLoss,
    distillation,
    edge_aware,
    unsupervised_loss,
    upflow_terms,
)
from robustflow.training.recipe import UpflowObjective  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]

HEIGHT, WIDTH = 8, 12
RNG = np.random.default_rng(11)
IMAGES = ndimage.gaussian_filter(RNG.random((2, 2, 3, HEIGHT, WIDTH)), (0, 0, 0, 1, 1))
"""Both frames of two pairs."""
FLOWS = RNG.normal(0, 1.5, (2, 2, 2, HEIGHT, WIDTH))
"""Flows of two pairs in both directions."""
MASK = (RNG.random((2, 1, HEIGHT, WIDTH)) < 0.7).astype(float)
LUMA = (0.2989, 0.5870, 0.1140)


def tensor(array) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array))


def close(found: torch.Tensor, expected, rel: float = 1e-6) -> None:
    np.testing.assert_allclose(found.numpy(), expected, rtol=rel, atol=rel)


def warped(maps, flow, mode="constant"):
    """Sample maps (C, H, W) at pixel + flow (2, H, W); "constant" is 0 outside, and "nearest" repeats the border."""
    y, x = np.mgrid[:HEIGHT, :WIDTH][:, : maps.shape[1], : maps.shape[2]]
    at = [y + flow[1], x + flow[0]]
    if mode == "nearest":
        return np.stack([ndimage.map_coordinates(one, at, order=1, mode="nearest") for one in maps])
    padded = np.pad(maps, ((0, 0), (20, 20), (20, 20)))
    return np.stack([ndimage.map_coordinates(one, [at[0] + 20, at[1] + 20], order=1) for one in padded])


def consistent(forward, backward):
    """The forward-backward check of Sundaram et al. for one pair."""
    returned = warped(backward, forward)
    lengths = (forward**2).sum(axis=0) + (returned**2).sum(axis=0)
    return ((forward + returned) ** 2).sum(axis=0) <= 0.01 * lengths + 0.5


def splatted(flow, values=None):
    """The values that the pixels of one pair carry along their flow, summed at the pixels where they land."""
    total = np.zeros(flow.shape[1:])
    for y, x in np.ndindex(total.shape):
        u, v = x + flow[0, y, x], y + flow[1, y, x]
        for row, column in np.ndindex(total.shape):
            share = max(0, 1 - abs(u - column)) * max(0, 1 - abs(v - row))
            total[row, column] += share * (1 if values is None else values[y, x])
    return total


def census(first, second, radius, luma, levels):
    """The differences of the soft ternary codes in each pixel's window, (H, W, window), of one pair."""
    codes = []
    for image in (first, second):
        grey = levels * np.tensordot(luma, image, 1)
        padded = np.pad(grey, radius)
        side = range(2 * radius + 1)
        steps = np.stack([padded[y : y + grey.shape[0], x : x + grey.shape[1]] - grey for y in side for x in side], -1)
        codes.append(steps / np.sqrt(0.81 + steps**2))
    squared = (codes[0] - codes[1]) ** 2
    return squared / (0.1 + squared)


def border(shape, width):
    inside = np.zeros(shape)
    inside[width:-width, width:-width] = 1
    return inside


def ssim(first, second):
    """(1 - SSIM) / 2 of every 3x3 window, (H - 2, W - 2), of one channel."""
    out = np.zeros((first.shape[0] - 2, first.shape[1] - 2))
    for y, x in np.ndindex(out.shape):
        a, b = first[y : y + 3, x : x + 3], second[y : y + 3, x : x + 3]
        covariance = ((a - a.mean()) * (b - b.mean())).mean()
        above = (2 * a.mean() * b.mean() + 0.0001) * (2 * covariance + 0.0009)
        out[y, x] = (1 - above / ((a.mean() ** 2 + b.mean() ** 2 + 0.0001) * (a.var() + b.var() + 0.0009))) / 2
    return out.clip(0, 1)


def weighted_steps(flow, image, alpha, second_order, span, penalty):
    """The weighted penalties of the differences along y and x, each (2, h, w); `span` is the step of the edges."""
    out = []
    for axis in (1, 2):
        steps, edges = np.diff(flow, 2 if second_order else 1, axis), np.diff(image, 1, axis)
        if span == 2:
            edges = np.take(image, range(2, image.shape[axis]), axis) - np.take(
                image, range(image.shape[axis] - 2), axis
            )
        elif second_order:
            edges = np.take(edges, range(1, edges.shape[axis]), axis)
        out.append(np.exp(-alpha * np.abs(edges).mean(axis=0)) * penalty(steps))
    return out


def test_the_forward_backward_check_equals_its_formula():
    flows = np.stack([FLOWS[0], RNG.normal(0, 1, FLOWS[0].shape) - FLOWS[0]]) * 0.4
    expected = np.stack([consistent(*pair)[None] for pair in flows.swapaxes(0, 1)])

    assert 0.1 < expected.mean() < 0.9
    assert np.array_equal(seen_by_check(tensor(flows[0]).float(), tensor(flows[1]).float()).numpy(), expected)


def test_the_splat_and_its_threshold_equal_their_formulas():
    flow, values = FLOWS[0], RNG.random((2, 1, HEIGHT, WIDTH))
    plain = np.stack([splatted(one)[None] for one in flow])

    close(coverage(tensor(flow)), plain)
    close(coverage(tensor(flow), tensor(values)), [splatted(f, v[0])[None] for f, v in zip(flow, values, strict=True)])
    assert (plain < 0.2).mean() > 0.02
    assert np.array_equal(seen_by_splat(tensor(flow)).numpy(), plain >= 0.2)


def test_the_photometric_distances_equal_their_formulas():
    first, second = IMAGES
    expected = [[ssim(a, b) for a, b in zip(*pair, strict=True)] for pair in zip(first, second, strict=True)]
    close(loss_terms.ssim_distance(tensor(first), tensor(second)), expected)

    expected = [
        census(a, b, 1, LUMA, 255).mean(-1) * border((HEIGHT, WIDTH), 1) for a, b in zip(first, second, strict=True)
    ]
    close(loss_terms.census_distance(tensor(first), tensor(second))[:, 0], expected)
    close(loss_terms.robust(tensor(FLOWS)), (np.abs(FLOWS) + 0.01) ** 0.4)
    close(loss_terms.robust(tensor(FLOWS), 0.7), (np.abs(FLOWS) + 0.01) ** 0.7)


@pytest.mark.parametrize("second_order", [False, True])
def test_smoothness_equals_its_formula(second_order):
    flow, image = FLOWS[0], IMAGES[0]
    scale = 1 if second_order else 0.5
    pairs = list(zip(flow, image, strict=True))

    terms = [weighted_steps(f, i, 10, second_order, 1, np.abs) for f, i in pairs]
    expected = sum(scale * np.mean([pair[axis] for pair in terms]) / 2 for axis in (0, 1))
    close(smoothness(tensor(flow), tensor(image), 10, second_order), expected)

    span = 2 if second_order else 1
    terms = [weighted_steps(f, i, 3, second_order, span, lambda d: np.sqrt(d**2 + 1e-6)) for f, i in pairs]
    expected = sum(np.mean([pair[axis].sum(axis=0) for pair in terms]) for axis in (0, 1)) / 2
    close(robust_smoothness(tensor(flow), tensor(image), 3, second_order), expected)
    close(charbonnier(tensor(flow)), np.sqrt(flow**2 + 1e-6))

    if not second_order:
        terms = [weighted_steps(f, i, 1, False, 1, np.abs) for f, i in pairs]
        close(edge_aware(tensor(flow), tensor(image)), sum(np.mean([pair[axis] for pair in terms]) for axis in (0, 1)))


@pytest.mark.parametrize("splat", [False, True])
@pytest.mark.parametrize("both", [False, True])
def test_arflows_loss_equals_its_formula(both, splat):
    weights = UnsupervisedLoss(
        l1=0.3,
        ssim=0.7,
        census=0.4,
        levels=(1.0, 0.5, 0.0),
        smooth=60.0,
        smooth_levels=(1.0, 0.25, 1.0),
        splat=splat,
        both=both,
        alpha=7.0,
        second_order=False,
    )
    small = RNG.normal(0, 0.7, (2, 2, 2, HEIGHT // 2, WIDTH // 2))
    flows = [FLOWS * 0.3, small, small[..., :2, :3]]
    photometric_terms, smooth = 0.0, 0.0
    directions = (0, 1) if both else (0,)
    for direction in directions:
        masks = []
        for one, other in zip(flows[0][direction], flows[0][1 - direction], strict=True):
            masks.append(splatted(other) >= 0.2 if splat else consistent(one, other))
        for level, size in ((0, 1), (1, 2)):
            pairs = IMAGES.reshape(2, 2, 3, HEIGHT // size, size, WIDTH // size, size).mean(axis=(4, 6))
            seen = np.stack(masks)[:, None, ::size, ::size].astype(float)
            own, flow = pairs[direction], flows[level][direction]
            moved = np.stack([warped(*one, "nearest") for one in zip(pairs[1 - direction], flow, strict=True)])
            l1 = (np.abs(own - moved) * seen).mean()
            visible = list(zip(moved * seen, own * seen, strict=True))
            windows = np.mean([ssim(a, b) for pair in visible for a, b in zip(*pair, strict=True)])
            shape = own.shape[2:]
            codes = np.mean([census(a, b, 1, LUMA, 255).mean(-1) * border(shape, 1) for a, b in visible])
            total = (0.3 * l1 + 0.7 * windows + 0.4 * codes) / seen.mean()
            photometric_terms += weights.levels[level] * total / len(directions)
            bent = [weighted_steps(f / shape[0], i, 7, False, 1, np.abs) for f, i in zip(flow, own, strict=True)]
            bent = sum(np.mean([pair[axis] for pair in bent]) / 4 for axis in (0, 1))
            shrunk = HEIGHT // size / HEIGHT  # flows are divided by the shorter side of the finest level
            smooth += 60 * weights.smooth_levels[level] * bent * shrunk / len(directions)

    forward, backward = ([tensor(level[direction]).float() for level in flows] for direction in (0, 1))
    terms = unsupervised_loss(forward, backward, *(tensor(one).float() for one in IMAGES), weights)

    close(terms.photometric, photometric_terms, 1e-4)
    close(terms.smoothness, smooth, 1e-4)
    close(terms.total, photometric_terms + smooth, 1e-4)


def test_upflows_terms_equal_their_formulas():
    settings = UpflowObjective(kind="upflow", photometric=0.7, census=0.3, smooth=0.2, distillation=0.9, radius=2)
    level = RNG.normal(0, 1, (2, 2, HEIGHT // 2, WIDTH // 2))
    ways = [(FLOWS[k], IMAGES[k] - 0.5, IMAGES[1 - k] - 0.4, np.roll(MASK, k, 3)) for k in (0, 1)]
    expected = dict.fromkeys(("photometric", "census", "smoothness", "distillation"), 0.0)
    for flow, image, moved, seen in ways:
        pairs = list(zip(image, moved, strict=True))
        expected["photometric"] += 0.7 * ((np.abs(image - moved) + 0.01) ** 0.4).mean()
        distances = np.stack([census(a, b, 2, LUMA, 1).sum(-1) for a, b in pairs])
        expected["census"] += 0.3 * ((distances + 0.01) ** 0.4).mean()
        steps = [weighted_steps(f, i, 1, False, 1, np.abs) for f, i in zip(flow, image, strict=True)]
        expected["smoothness"] += 0.2 * sum(np.mean([pair[axis] for pair in steps]) for axis in (0, 1))
        y, x = np.linspace(0, HEIGHT // 2 - 1, HEIGHT), np.linspace(0, WIDTH // 2 - 1, WIDTH)
        at = np.meshgrid(y, x, indexing="ij")
        larger = 2 * np.array([[ndimage.map_coordinates(one, at, order=1) for one in pair] for pair in level])
        for enlarged in (larger, 2 * larger):
            far = ((np.abs(enlarged - flow) + 0.01) ** 0.4).sum(axis=1, keepdims=True)
            expected["distillation"] += 0.9 * (far * seen).sum() / seen.sum()

    made = [OneWay(tensor(f), [tensor(level), tensor(2 * level)], *map(tensor, rest)) for f, *rest in ways]
    terms = upflow_terms(made, settings)

    for name, value in expected.items():
        close(terms[name], value, 1e-5)
    flow, *rest = ways[0]
    hidden = OneWay(tensor(flow), [tensor(level)], *map(tensor, (*rest[:2], 0 * MASK)))
    assert distillation(hidden) == 0


def test_brightflows_terms_equal_their_formulas():
    first, second = 255 * IMAGES
    pairs, luma = list(zip(first, second, strict=True)), (0.2989, 0.1140, 0.5870)

    def masked(values, mask):
        each = [(v * m).sum() / (m.sum() + 1e-5) for v, m in zip(values, mask, strict=True)]
        return np.mean(each)

    losses = [1.5, 0.5, 2.0]
    close(brightflow.over_iterations([tensor(np.float64(one)) for one in losses]), 0.64 * 1.5 + 0.8 * 0.5 + 2.0)
    close(brightflow.masked_mean(tensor(FLOWS[0, :, :1]), tensor(MASK)), masked(FLOWS[0, :, :1], MASK))

    inside = border((HEIGHT, WIDTH), 3)
    distances = np.stack([(census(a, b, 3, luma, 1).sum(-1) + 0.01) ** 0.4 for a, b in pairs])[:, None]
    close(brightflow.masked_census(tensor(first), tensor(second), tensor(MASK)), masked(distances, MASK * inside))

    expected = masked(np.abs(first - second).sum(axis=1, keepdims=True) / 255, MASK)
    close(brightflow.correction_loss(tensor(first), tensor(second), tensor(MASK)), expected)

    cut = FLOWS[0][:, :, 2:-2, 2:-2]
    at = np.meshgrid(np.linspace(0, HEIGHT - 5, HEIGHT), np.linspace(0, WIDTH - 5, WIDTH), indexing="ij")
    teacher = np.array([[ndimage.map_coordinates(one, at, order=1) for one in pair] for pair in cut])
    teacher *= np.array([WIDTH / (WIDTH - 4), HEIGHT / (HEIGHT - 4)])[:, None, None]
    students = [FLOWS[1], FLOWS[1] * 0.5]
    far = [np.sqrt((one - teacher) ** 2 + 1e-6).sum(axis=1).mean() for one in students]
    found = brightflow.self_supervised([tensor(one) for one in students], tensor(FLOWS[0]), 2)
    close(found, 0.8 * far[0] + far[1], 1e-5)


@pytest.mark.parametrize("occlusion", ["brox", "wang"])
def test_brightflows_visibility_equals_its_formula(occlusion):
    forward, backward = FLOWS[0], -FLOWS[0] + RNG.normal(0, 0.4, FLOWS[0].shape)
    corners, sizes = np.array([[2.0, 1.0], [0.0, 2.0]]), np.array([[14.0, 10.0], [13.0, 11.0]])
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    expected = []
    for f, b, (left, top), (width, height) in zip(forward, backward, corners, sizes, strict=True):
        seen = np.clip(splatted(b), 0, 1) if occlusion == "wang" else consistent(f, b).astype(float)
        u, v = x + f[0], y + f[1]
        outside_crop = (u < 0) | (u > WIDTH - 1) | (v < 0) | (v > HEIGHT - 1)
        in_frame = (u + left >= 0) & (u + left <= width - 1) & (v + top >= 0) & (v + top <= height - 1)
        expected.append(np.where(outside_crop, 1, seen) * in_frame)

    arguments = (tensor(one).float() for one in (forward, backward, corners, sizes))
    close(brightflow.visibility(*arguments, occlusion)[:, 0], expected, 1e-5)


def test_offsets_are_added_inside_each_crop():
    whole, offsets = RNG.random((2, 3, 11, 17)), RNG.random((2, 3, HEIGHT - 3, WIDTH - 3))
    expected = whole.copy()
    for number, (x, y) in enumerate([(4, 1), (0, 5)]):
        expected[number, :, y : y + 5, x : x + 9] += offsets[number]

    close(brightflow.with_offsets(tensor(whole), tensor(offsets), tensor([[4.0, 1.0], [0.0, 5.0]])), expected)
    assert not np.array_equal(whole, expected), "the argument was changed"


def test_offsets_are_kept_where_pixels_that_they_improve_land():
    target, without = 255 * IMAGES
    better = target + RNG.normal(0, 40, target.shape)
    flow = np.round(FLOWS[0])
    near, far = np.abs(target - better).mean(axis=1), np.abs(target - without).mean(axis=1)
    expected = [splatted(f, (a < b).astype(float)) > 0 for f, a, b in zip(flow, near, far, strict=True)]

    found = brightflow.kept_offsets(*map(tensor, (target, without, better, flow)))

    assert 0.1 < np.mean(expected) < 0.9
    assert np.array_equal(found[:, 0].numpy(), expected)
