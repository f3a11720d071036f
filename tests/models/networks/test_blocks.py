"""Network blocks match float64 loops written from their definitions, and have properties that the parity packs do not
cover.
"""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch.nn.functional import conv2d

from robustflow.models.networks.blocks.attention import (
    attend,
    context_attention,
    from_windows,
    gather,
    linear_sine,
    to_windows,
)
from robustflow.models.networks.blocks.correlation import (
    CorrelationPyramid,
    WindowVolume,
    all_pairs,
    local_correlation,
    pixel_grid,
    sample_window,
)
from robustflow.models.networks.blocks.pwc import inside_mask, warp
from robustflow.models.networks.blocks.raft import SepConvGRU, convex_upsample
from robustflow.models.networks.blocks.twins import PatchEmbedding, Twins

pytestmark = pytest.mark.torch


def bilinear(image: np.ndarray, x: float, y: float) -> float:
    """Return the value at (x, y), zero outside the image."""
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    value = 0.0
    for row, wy in ((y0, y0 + 1 - y), (y0 + 1, y - y0)):
        for column, wx in ((x0, x0 + 1 - x), (x0 + 1, x - x0)):
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                value += wx * wy * image[row, column]
    return value


def naive_lookup(features1, features2, coordinates, levels, radius):
    channels, height, width = features1.shape
    out = np.zeros((levels * (2 * radius + 1) ** 2, height, width))
    for y in range(height):
        for x in range(width):
            level_map = np.einsum("c,chw->hw", features1[:, y, x], features2) / np.sqrt(channels)
            channel = 0
            for level in range(levels):
                cx, cy = coordinates[:, y, x] / 2**level
                for dx in range(-radius, radius + 1):
                    for dy in range(-radius, radius + 1):
                        out[channel, y, x] = bilinear(level_map, cx + dx, cy + dy)
                        channel += 1
                h, w = level_map.shape[0] // 2, level_map.shape[1] // 2
                level_map = level_map[: 2 * h, : 2 * w].reshape(h, 2, w, 2).mean(axis=(1, 3))
    return out


def test_lookup_is_the_definition():
    rng = np.random.default_rng(0)
    features1, features2 = rng.standard_normal((2, 2, 5, 9, 11))
    coordinates = rng.uniform(-4, 14, (2, 2, 9, 11))
    pyramid = CorrelationPyramid(torch.from_numpy(features1), torch.from_numpy(features2), levels=3, radius=2)
    found = pyramid.lookup(torch.from_numpy(coordinates)).numpy()
    for sample in range(2):
        expected = naive_lookup(features1[sample], features2[sample], coordinates[sample], 3, 2)
        np.testing.assert_allclose(found[sample], expected, atol=2e-5)


def test_lookup_interpolates_in_a_level_one_pixel_wide():
    found = sample_window(torch.ones(1, 1, 1, 1), torch.tensor([[0.25, 0.0]]), radius=1)
    # x offsets vary slowest: the entries at y offset 0 from each of the three columns, at x = -0.75, 0.25, 1.25
    np.testing.assert_allclose(found.reshape(3, 3)[:, 1], [0.25, 0.75, 0.0], atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2)])
def test_small_maps_stay_finite(size):
    features = torch.randn(1, 4, *size, generator=torch.Generator().manual_seed(0))
    assert CorrelationPyramid(features, features).lookup(pixel_grid(features)).isfinite().all()


def test_volume_is_float32_under_autocast():
    features = torch.randn(1, 8, 4, 6, generator=torch.Generator().manual_seed(0))
    with torch.autocast("cpu", torch.bfloat16):
        found = all_pairs(features, features)
    assert torch.equal(found, all_pairs(features, features))


def naive_attention(query, key, value, bias):
    """Compute one attention head in float64 on lists of vectors."""
    rows = []
    for i, q in enumerate(query.double()):
        logits = torch.stack([(q * k).sum() for k in key.double()]) / len(q) ** 0.5 + bias[i].double()
        weights = torch.exp(logits - logits.max())
        rows.append((weights[:, None] * value.double()).sum(dim=0) / weights.sum())
    return torch.stack(rows)


def test_attend_is_softmax_attention_of_each_head():
    generator = torch.Generator().manual_seed(0)
    query, key, value, bias = (
        torch.randn(shape, generator=generator) for shape in ((2, 5, 12), (2, 7, 12), (2, 7, 9), (2, 3, 5, 7))
    )
    found = attend(query, key, value, heads=3, bias=bias)
    for n in range(2):
        for head in range(3):
            q, k = (t[n, :, 4 * head : 4 * head + 4] for t in (query, key))
            wanted = naive_attention(q, k, value[n, :, 3 * head : 3 * head + 3], bias[n, head])
            torch.testing.assert_close(found[n, :, 3 * head : 3 * head + 3].double(), wanted, atol=1e-6, rtol=1e-5)


def test_context_attention_gathers_like_a_single_head():
    generator = torch.Generator().manual_seed(1)
    query_key = torch.randn((2, 12, 3, 4), generator=generator)
    values = torch.randn((2, 5, 3, 4), generator=generator)
    found = gather(context_attention(query_key), values).flatten(2)
    for n in range(2):
        query, key = query_key[n].flatten(1).T.chunk(2, dim=1)
        wanted = naive_attention(query, key, values[n].flatten(1).T, torch.zeros(12, 12)).T
        torch.testing.assert_close(found[n].double(), wanted, atol=1e-6, rtol=1e-5)


def test_the_code_is_sines_and_cosines_at_growing_frequency():
    code = linear_sine(torch.tensor([[30.0, 7.0]]), 16)[0]
    for band in range(4):
        for axis, place in ((0, 30.0), (1, 7.0)):
            angle = torch.tensor(3.14 * place * band / 200)
            assert abs(code[8 * axis + band] - angle.sin()) < 1e-6
            assert abs(code[8 * axis + 4 + band] - angle.cos()) < 1e-6


@pytest.mark.parametrize("factor", [4, 8])
def test_every_fine_pixel_is_its_weighted_mean(factor):
    rng = np.random.default_rng(0)
    flow, mask = rng.standard_normal((2, 3, 4)), rng.standard_normal((9, factor, factor, 3, 4))
    weights = np.exp(mask) / np.exp(mask).sum(axis=0)
    padded = np.pad(flow, ((0, 0), (1, 1), (1, 1)))
    expected = np.zeros((2, 3 * factor, 4 * factor))
    for y, x in np.ndindex(3 * factor, 4 * factor):
        (row, dy), (column, dx) = divmod(y, factor), divmod(x, factor)
        for k in range(9):
            neighbour = padded[:, row + k // 3, column + k % 3]
            expected[:, y, x] += factor * weights[k, dy, dx, row, column] * neighbour
    found = convex_upsample(
        torch.from_numpy(flow)[None], torch.from_numpy(mask).reshape(1, 9 * factor**2, 3, 4), factor
    )
    np.testing.assert_allclose(found[0], expected, atol=1e-5)


def test_the_gru_updates_along_rows_and_then_along_columns():
    generator = torch.Generator().manual_seed(1)
    state, inputs = torch.randn(1, 6, 5, 7, generator=generator), torch.randn(1, 4, 5, 7, generator=generator)
    torch.manual_seed(0)
    unit = SepConvGRU(hidden=6, inputs=4)
    gates = unit.state_dict()

    def gate(name, state, padding):
        return conv2d(torch.cat((state, inputs), 1), gates[f"conv{name}.weight"], gates[f"conv{name}.bias"], 1, padding)

    with torch.no_grad():
        found, expected = unit(state, inputs), state
    for step, padding in ((1, (0, 2)), (2, (2, 0))):  # kernels of 1 x 5, then of 5 x 1
        update, reset = (gate(f"{name}{step}", expected, padding).sigmoid() for name in "zr")
        candidate = gate(f"q{step}", reset * expected, padding).tanh()
        expected = (1 - update) * expected + update * candidate
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("radius", [1, 2, 4])
def test_each_channel_is_one_displacement(radius):
    features1, features2 = np.random.default_rng(0).standard_normal((2, 2, 5, 6, 7))
    side = 2 * radius + 1
    expected = np.zeros((2, side**2, 6, 7))
    for n, y, x in np.ndindex(2, 6, 7):
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                if 0 <= y + dy < 6 and 0 <= x + dx < 7:
                    product = features1[n, :, y, x] * features2[n, :, y + dy, x + dx]
                    expected[n, (dy + radius) * side + dx + radius, y, x] = product.mean()
    found = local_correlation(torch.from_numpy(features1), torch.from_numpy(features2), radius)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_dense_patches_hold_the_strided_ones():
    torch.manual_seed(0)
    embedding = PatchEmbedding(3, 8, 2)
    x = torch.rand(1, 3, 10, 14)
    dense = embedding(x, dense=True)
    assert dense.shape == (1, 10, 14, 8)
    torch.testing.assert_close(dense[:, 1::2, 1::2], embedding(x))


def test_a_map_no_multiple_of_windows_or_reductions_is_encoded():
    torch.manual_seed(0)
    net = Twins(large=False).eval()
    images = torch.rand(2, 3, 8 * 5, 8 * 9)
    with torch.no_grad():
        both = net(images)
        assert both.shape == (2, 128, 5, 9)
        torch.testing.assert_close(both[1:], net(images[1:]), atol=1e-5, rtol=1e-5)


HEIGHT, WIDTH = 6, 9


def maps_and_flow():
    rng = np.random.default_rng(0)
    return rng.standard_normal((2, 3, HEIGHT, WIDTH)), rng.uniform(-5, 5, (2, 2, HEIGHT, WIDTH))


@pytest.mark.parametrize("padding", ["zeros", "border"])
@pytest.mark.parametrize("align_corners", [True, False])
def test_every_pixel_is_fetched_where_the_flow_points(padding, align_corners):
    maps, flow = maps_and_flow()
    expected = np.zeros_like(maps)
    for n, c, y, x in np.ndindex(maps.shape):
        to_x, to_y = x + flow[n, 0, y, x], y + flow[n, 1, y, x]
        if not align_corners:
            # Coordinates are normalised by size - 1, but interpreted as fractions of the full width, which extends
            # half a pixel beyond the outermost pixels.
            to_x, to_y = to_x * WIDTH / (WIDTH - 1) - 0.5, to_y * HEIGHT / (HEIGHT - 1) - 0.5
        if padding == "border":
            to_x, to_y = np.clip(to_x, 0, WIDTH - 1), np.clip(to_y, 0, HEIGHT - 1)
        expected[n, c, y, x] = bilinear(maps[n, c], to_x, to_y)
    found = warp(torch.from_numpy(maps), torch.from_numpy(flow), padding, align_corners)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_the_mask_is_where_all_four_neighbours_are_inside():
    _, flow = maps_and_flow()
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    to_x, to_y = x + flow[:, 0], y + flow[:, 1]
    inside = (to_x >= 0) & (to_x <= WIDTH - 1) & (to_y >= 0) & (to_y <= HEIGHT - 1)
    found = inside_mask(torch.from_numpy(flow).float(), 0.9999)
    assert 0.2 < inside.mean() < 0.8
    np.testing.assert_array_equal(found[:, 0].numpy(), inside)


def test_a_lower_threshold_lets_part_of_the_border_in():
    flow = torch.full((1, 2, 4, 4), 0.0)
    flow[:, 0] = 0.25
    columns = [inside_mask(flow, threshold)[0, 0, 0].tolist() for threshold in (0.9999, 0.7, 0.8)]
    assert columns == [[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 0]]


def test_one_pixel_maps_are_fetched_without_dividing_by_zero():
    assert warp(torch.ones(1, 2, 1, 1), torch.zeros(1, 2, 1, 1)).tolist() == [[[[1.0]], [[1.0]]]]


@pytest.mark.parametrize(("height", "width", "size"), [(14, 21, 7), (9, 15, 7), (3, 5, 14), (8, 8, 8)])
def test_windows_are_slices_padded_with_zeros(height, width, size):
    x = torch.arange(2 * height * width * 3, dtype=torch.float32).view(2, height, width, 3) + 1
    windows = to_windows(x, size)
    columns = -(-width // size)
    for index in range(windows.shape[1]):
        top, left = index // columns * size, index % columns * size
        piece = x[:, top : top + size, left : left + size]
        window = windows[:, index].view(2, size, size, 3)
        assert torch.equal(window[:, : piece.shape[1], : piece.shape[2]], piece)
        assert window.count_nonzero() == piece.numel()
    assert torch.equal(from_windows(windows, height, width), x)


def test_levels_are_dot_products_around_the_rounded_target():
    generator = torch.Generator().manual_seed(0)
    features1, features2 = (torch.randn((2, 4, 5, 6), generator=generator) for _ in range(2))
    target = pixel_grid(features1) + 3 * torch.randn((2, 2, 5, 6), generator=generator)
    target[0, :, 0, 0] = 1e6  # far outside
    volume = WindowVolume(features1, features2, target)
    for n in range(2):
        for y in range(5):
            for x in range(6):
                to_x, to_y = (int(v) for v in target[n, :, y, x].round())
                window = np.zeros((17, 17))
                for row in range(17):
                    for column in range(17):
                        at_y, at_x = to_y + row - 8, to_x + column - 8
                        if 0 <= at_y < 5 and 0 <= at_x < 6:
                            window[row, column] = (features1[n, :, y, x] * features2[n, :, at_y, at_x]).sum() / 2
                index = (n * 5 + y) * 6 + x
                for level in volume.levels:
                    np.testing.assert_allclose(level[index, 0].numpy(), window, atol=1e-5)
                    side = window.shape[0] // 2
                    window = window[: 2 * side, : 2 * side].reshape(side, 2, side, 2).mean(axis=(1, 3))
