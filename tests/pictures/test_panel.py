"""Panels show the right colours, and handle sparse maps, odd sizes and malicious names."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from robustflow.core.types import Sample
from robustflow.media.colours import (
    HIGHEST,
    LOWEST,
    REACH,
    SPARSE,
    UNKNOWN_COLOUR,
    error_colours,
    flow_colours,
    thickened,
)
from robustflow.pictures.panel import draw_panel, panel_title
from robustflow.run.worker import View


def _draw(height: int, width: int, truth: bool, title: str = "title") -> bytes:
    rng = np.random.default_rng(0)
    frames = tuple(rng.integers(0, 255, (height, width, 3)).astype(np.uint8) for _ in range(2))
    flow = rng.normal(0, 5, (height, width, 2)).astype(np.float32)
    known = {"flow": flow, "valid": rng.random((height, width)) < 0.2} if truth else {}
    return draw_panel(View(Sample("a", frames, **known), frames[::-1], flow + 1, flow, {}), title, "EPE 1.00 px")


def test_errors_grow_brighter_on_a_logarithmic_scale():
    errors = np.geomspace(LOWEST, HIGHEST, 200)[None]
    light = error_colours(errors).astype(float)[0] @ (0.2126, 0.7152, 0.0722)
    assert (light[10:] > light[:-10]).all(), "more is brighter"
    middle = error_colours(np.array([[np.sqrt(LOWEST * HIGHEST)]]))[0, 0]
    assert np.abs(middle.astype(int) - error_colours(errors)[0, 100]).max() <= 3
    outside = error_colours(np.array([[0.0, LOWEST, HIGHEST, np.inf, np.nan]]))[0]
    assert outside[0].tolist() == outside[1].tolist()
    assert outside[2].tolist() == outside[3].tolist()
    assert tuple(outside[4]) == UNKNOWN_COLOUR


@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_known_points_grow_by_a_little(known):
    height, width = known.shape
    picture = np.where(known[..., None], np.arange(1, known.size + 1).reshape(height, width, 1), 0).astype(np.uint8)
    picture = np.repeat(picture, 3, axis=2)
    shown = thickened(picture, known)
    points = np.argwhere(known)
    for y, x in np.ndindex(height, width):
        distances = np.hypot(*(points - (y, x)).T) if len(points) else np.array([np.inf])
        if known[y, x] or distances.min() > REACH or known.mean() >= SPARSE:
            assert shown[y, x].tolist() == picture[y, x].tolist()
        else:
            nearest = points[distances == distances.min()]
            assert shown[y, x].tolist() in [picture[tuple(point)].tolist() for point in nearest]


def test_panel_has_its_images_in_their_places():
    """Every picture of the panel is plain, in a different colour."""
    first, second, corrupted, also_corrupted = (np.full((70, 100, 3), grey, np.uint8) for grey in (30, 60, 120, 200))
    clean, flow, truth = (np.full((70, 100, 2), np.float32(vector)) for vector in ((3, 0), (0, 2), (-4, 0)))
    sample = Sample("a", (first, second), truth, np.ones((70, 100), bool))
    drawn = draw_panel(View(sample, (corrupted, also_corrupted), flow, clean, {}), "title", "EPE 1.00 px")
    with Image.open(io.BytesIO(drawn)) as picture:
        shown = np.asarray(picture.convert("RGB"), int)
    errors = error_colours(np.full((1, 1), np.hypot(4, 2)))
    flows = [flow_colours(each[:1, :1], 4.0) for each in (clean, flow, truth)]
    pitch = (len(shown) - 40 - 92) / 4  # a head of 40 pixels and a legend of 92
    for index, expected in enumerate((first, second, corrupted, also_corrupted, *flows, errors)):
        row, column = divmod(index, 2)
        found = shown[round(40 + (row + 0.5) * pitch), 350 + 700 * column]
        assert np.abs(found - expected[0, 0]).max() <= 2, index


@pytest.mark.parametrize("truth", [True, False])
def test_a_panel_has_the_colour_wheel_of_its_flows(truth):
    """The colours at the right and left edges of the wheel match flow to the right and to the left."""
    drawn = np.asarray(Image.open(io.BytesIO(_draw(70, 100, truth))).convert("RGB"), float)
    sides = flow_colours(np.array([[[1.0, 0.0], [-1.0, 0.0]]], np.float32), 1.0)[0].astype(float)
    part = drawn[-92:, :100] if truth else drawn[-560:-92, 100:600]
    found = [np.argwhere(np.abs(part - side).sum(axis=2) < 30) for side in sides]
    assert all(len(places) > 5 for places in found)
    assert found[0][:, 1].mean() > found[1][:, 1].mean() + 30


@pytest.mark.parametrize(("height", "width"), [(4000, 30), (8, 900), (16, 16)])
def test_panel_of_unusual_frame_sizes_is_readable(height, width):
    with Image.open(io.BytesIO(_draw(height, width, True))) as picture:
        assert picture.width == 1400
        assert picture.height < 3200


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["$x^$", "_hidden", "a\nb", "\x1b[31mred", "x" * 500, "\\frac{", "日本"])
def test_panel_draws_any_name(name):
    title = panel_title(name, "fog", 3, "worst")
    assert "\n" not in title
    assert len(title) < 120
    assert _draw(20, 30, False, title)
