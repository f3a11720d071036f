"""The quick blur against the exact one: the same bytes, whatever the image."""

from __future__ import annotations

import numpy as np
import pytest
import skimage.data
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.psf import rounded_blur as module
from robustflow.psf.blur import blur
from robustflow.psf.exact_values import ExactValues
from robustflow.psf.near_blur import GREY, near_blur, near_kernels
from robustflow.psf.psf_field import PsfField
from robustflow.psf.rounded_blur import FINE, MARGIN, NEAR_MARGIN, rounded_blur
from robustflow.psf.shipped import shipped_field


def image(kind: str, height: int, width: int, seed: int = 0) -> np.ndarray:
    """Of pictures that are hard in a way of their own."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    if kind == "photograph":
        return np.resize(skimage.data.astronaut(), (height, width, 3))
    if kind == "noise":
        return rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
    if kind == "black and white":
        return (255 * rng.integers(0, 2, (height, width, 3))).astype(np.uint8)
    if kind == "board":
        return np.repeat(((x + y) % 2 * 255).astype(np.uint8)[..., None], 3, axis=2)
    if kind == "two greys":  # blurs to values at the middle between them
        return np.repeat((77 + x % 2).astype(np.uint8)[..., None], 3, axis=2)
    if kind == "ramp":
        return np.repeat((x * 255 // max(width - 1, 1)).astype(np.uint8)[..., None], 3, axis=2)
    return np.full((height, width, 3), seed % 256, np.uint8)


KINDS = ("photograph", "noise", "black and white", "board", "two greys", "ramp", "flat")


def exact(frame: np.ndarray, field: PsfField) -> np.ndarray:
    return np.clip(np.rint(blur(frame, field)), 0, 255).astype(np.uint8)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(1, 170),
    st.integers(1, 170),
    st.sampled_from(KINDS),
    st.integers(1, 5),
    st.integers(0, 2**20),
)
def test_the_bytes_are_those_of_the_exact_blur(height, width, kind, severity, seed):
    frame = image(kind, height, width, seed)
    assert (rounded_blur(frame, shipped_field(severity)) == exact(frame, shipped_field(severity))).all()


@pytest.mark.slow
@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_the_bytes_are_those_of_the_exact_blur_at_full_size(kind, severity):
    for height, width in ((375, 1242), (720, 1280), (540, 961)):
        frame = image(kind, height, width, severity)
        assert (rounded_blur(frame, shipped_field(severity)) == exact(frame, shipped_field(severity))).all()


def every_place(height: int, width: int) -> np.ndarray:
    """Of the values of an image, y, x and channel, int32 (n, 3)."""
    return np.indices((height, width, 3), np.int32).reshape(3, -1).T.copy()


def exact_values(frame: np.ndarray, field: PsfField) -> ExactValues:
    return ExactValues(frame, field, near_kernels(field, *frame.shape[:2]).kernel)


@pytest.mark.parametrize("severity", [1, 2, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_sums_stay_far_within_their_margins(kind, severity):
    frame, field = image(kind, 150, 222, severity), shipped_field(severity)
    wanted, near = blur(frame, field), near_blur(frame, field, 1)
    error = near.total[:, near.left : near.left + 222].transpose(2, 1, 0) + GREY - wanted
    assert np.abs(error).max() < NEAR_MARGIN / 3
    plain = module._plain_values(frame, near, every_place(150, 222)) - wanted.ravel()
    assert np.abs(plain).max() < MARGIN / 2


@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (61, 2), (97, 143), (30, 700)])
def test_plain_sums_are_those_of_the_blur_at_every_place(shape):
    frame, field = image("noise", *shape), shipped_field(4)
    values = module._plain_values(frame, near_blur(frame, field, 1), every_place(*shape))
    assert np.abs(values.reshape(*shape, 3) - blur(frame, field)).max() < MARGIN


def test_kernels_with_negative_values_in_every_row():
    rng = np.random.default_rng(0)
    field = PsfField(rng.normal(1.0, 0.8, (64, 3, 61, 61)))
    frame = image("noise", 60, 91)
    assert (rounded_blur(frame, field) == exact(frame, field)).all()


@pytest.mark.parametrize("mean", [0.3, 0.1, 0.05])
def test_margins_grow_with_the_negative_values_of_kernels(mean):
    field = PsfField(np.random.default_rng(0).normal(mean, 1.0, (64, 3, 61, 61)))
    frame = image("black and white", 60, 91)
    wanted, near = blur(frame, field), near_blur(frame, field, 1)
    gain = near.kernels.gain
    assert gain > 1.5
    error = near.total[:, near.left : near.left + 91].transpose(2, 1, 0) + GREY - wanted
    assert np.abs(error).max() < gain * NEAR_MARGIN / 3
    assert np.abs(module._plain_values(frame, near, every_place(60, 91)) - wanted.ravel()).max() < gain * MARGIN / 2
    assert (rounded_blur(frame, field) == exact(frame, field)).all()


def test_kernels_without_negative_values_have_no_gain():
    assert near_kernels(shipped_field(5), 60, 91).gain == pytest.approx(1.0, abs=1e-5)


def test_noise_is_what_plain_sums_lack():
    frame, field = image("black and white", 80, 131), shipped_field(1)
    wanted, values = blur(frame, field), exact_values(frame, field)
    rng = np.random.default_rng(3)
    places = np.stack([rng.integers(0, size, 40) for size in frame.shape], axis=1).astype(np.int32)
    plain = module._plain_values(frame, near_blur(frame, field, 1), places)
    for (y, x, channel), value in zip(places.tolist(), plain.tolist(), strict=True):
        weights, noises = zip(*values.noise(y, x, channel, GREY), strict=True)
        assert sum(weights) == pytest.approx(1.0)
        assert list(weights) == sorted(weights, reverse=True)
        assert abs(value + np.dot(weights, noises) - wanted[y, x, channel]) < FINE / 10
    assert np.std(plain - wanted[tuple(places.T)]) > FINE


@pytest.mark.parametrize("fine", [0.0, 1.0])
def test_values_are_repaired_with_the_noise_or_alone(monkeypatch, fine):
    frame, field = image("photograph", 20, 31), shipped_field(4)
    monkeypatch.setattr(module, "NEAR_MARGIN", 0.2)
    monkeypatch.setattr(module, "MOST_NEAR", 1)
    monkeypatch.setattr(module, "MARGIN", 0.1)
    monkeypatch.setattr(module, "MOST", 10**6)
    monkeypatch.setattr(module, "FINE", fine)
    monkeypatch.setattr(module, "blur", lambda *_: pytest.fail("the whole image was computed again"))
    assert (rounded_blur(frame, field) == exact(frame, field)).all()


@pytest.mark.parametrize(("most_near", "most"), [(0.001, 10**6), (1, 0), (1, 3)])
def test_an_image_with_many_close_values_goes_to_the_exact_blur(monkeypatch, most_near, most):
    frame, field = image("noise", 40, 50), shipped_field(2)
    monkeypatch.setattr(module, "NEAR_MARGIN", 0.4)
    monkeypatch.setattr(module, "MARGIN", 0.4)
    monkeypatch.setattr(module, "MOST_NEAR", most_near)
    monkeypatch.setattr(module, "MOST", most)
    monkeypatch.setattr(ExactValues, "value", lambda *_: pytest.fail("a value was computed alone"))
    assert (rounded_blur(frame, field) == exact(frame, field)).all()


def test_a_tie_goes_to_the_exact_blur(monkeypatch):
    frame, field = image("noise", 24, 24), shipped_field(2)
    monkeypatch.setattr(module, "NEAR_MARGIN", 0.01)
    monkeypatch.setattr(module, "MARGIN", 0.01)
    monkeypatch.setattr(module, "FINE", 1.0)
    monkeypatch.setattr(ExactValues, "value", lambda *_: 3.5)
    assert (rounded_blur(frame, field) == exact(frame, field)).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (61, 2), (97, 143), (375, 1242)])
def test_single_values_are_those_of_the_blur(shape):
    frame, field = image("noise", *shape), shipped_field(5)
    wanted, values = blur(frame, field), exact_values(frame, field)
    rng = np.random.default_rng(1)
    for _ in range(6):
        y, x, channel = (int(rng.integers(size)) for size in (*shape, 3))
        assert abs(values.value(y, x, channel) - wanted[y, x, channel]) < 1e-11


def test_threads_change_no_byte():
    frame, field = image("photograph", 150, 222), shipped_field(2)
    assert (rounded_blur(frame, field, threads=1) == rounded_blur(frame, field, threads=3)).all()
