"""Test dense inverse search on colour frames: with known motion, on unusual frames, and against OpenCV's version."""

import os
import platform
import subprocess
import sys
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift
from skimage import data

from robustflow import load_model
from robustflow.models.dis.dis_rgb import OPERATING_POINTS

SHIFTS = [(0.5, -0.25), (3.3, 2.7), (-7.5, 4.4), (12.4, -9.8), (-19.6, 3.2)]


def shifted(image, u, v, mode):
    planes = [shift(image[..., c].astype(float), (v, u), order=5, mode=mode) for c in range(3)]
    return np.clip(np.rint(np.stack(planes, axis=-1)), 0, 255).astype(np.uint8)


@cache
def moved(photograph, u, v):
    """The centre of a photograph, and the same region of the shifted photograph."""
    image = photograph()
    after = shifted(image, u, v, "mirror")
    top, left = (image.shape[0] - 240) // 2, (image.shape[1] - 320) // 2
    window = np.s_[top : top + 240, left : left + 320]
    return image[window].copy(), after[window]


def error_inside(flow, u, v):
    inside = flow[32:-32, 32:-32]
    return float(np.hypot(inside[..., 0] - u, inside[..., 1] - v).mean())


def texture(seed, size=(96, 128), sigma=1.5):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(*size, 3)), (sigma, sigma, 0), mode="wrap")
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("image", [data.astronaut, data.coffee, data.chelsea])
@pytest.mark.parametrize("point", [2, 3, 4])
def test_a_translated_photograph_is_recovered_to_a_tenth_of_a_pixel(image, point):
    for u, v in SHIFTS if point < 4 else SHIFTS[1::2]:
        assert error_inside(load_model("dis_rgb", operating_point=point).predict(*moved(image, u, v)), u, v) < 0.1


@pytest.mark.parametrize("sigma", [1.5, 6])
@pytest.mark.parametrize("size", [(96, 128), (240, 320), (436, 1024)])
def test_the_default_recovers_a_translated_texture_to_a_tenth_of_a_pixel(size, sigma):
    """Frames of at least 640 px are searched at 1/8 resolution, so 0.1 px in the frame is an eightieth of a pixel in
    the search.
    """
    height, width = size
    image = texture(5, (height + 40, width + 40), sigma)
    for u, v in ((3.0, -2.0), (5.5, 4.25), (-7.6, 8.3)):
        window = np.s_[20 : 20 + height, 20 : 20 + width]
        flow = load_model("dis_rgb").predict(image[window], shifted(image, u, v, "grid-wrap")[window])
        assert error_inside(flow, u, v) < 0.1


def test_motion_of_colours_of_equal_luminance_is_found():
    """The pattern has the same grey level everywhere, so only the colour method can detect its motion."""
    red = texture(0, (160, 208), 3.0)[..., 0] // 2 + 60
    blue = texture(1, (160, 208), 3.0)[..., 0] // 2 + 60
    green = np.rint((128 - 0.299 * red - 0.114 * blue) / 0.587).astype(np.uint8)
    frame1 = np.stack([red, green, blue], axis=-1)
    frame2 = np.roll(frame1, (-3, 5), axis=(0, 1))
    assert np.unique(cv2.cvtColor(frame1, cv2.COLOR_RGB2GRAY)).size == 1
    assert error_inside(load_model("dis_rgb", operating_point=3).predict(frame1, frame2), 5, -3) < 0.1
    assert error_inside(load_model("dis").predict(frame1, frame2), 5, -3) > 5


def test_flow_does_not_depend_on_memory_layout_or_previous_frames():
    frame1, frame2 = texture(3), np.roll(texture(3), 2, axis=1)
    model = load_model("dis_rgb")
    flow = model.predict(frame1, frame2)
    model.predict(frame2, frame1)
    frozen = frame1[::-1, :, ::-1].copy()[::-1, :, ::-1]
    frozen.flags.writeable = False
    np.testing.assert_array_equal(model.predict(frozen, np.asfortranarray(frame2)), flow)


def test_operating_points_have_different_identities():
    default = load_model("dis_rgb").identity()
    assert default["operating_point"] == 2
    assert default == load_model("dis_rgb", operating_point=2).identity()
    assert len({str(load_model("dis_rgb", operating_point=p).identity()) for p in OPERATING_POINTS}) == 4


BYTES = """
import hashlib
import numpy as np
from robustflow import load_model
from robustflow.data.datasets.motorcycle import Motorcycle

frames = [frame[100:221, 200:387] for frame in Motorcycle().load("motorcycle").frames]
for point in (1, 2, 3, 4):
    print(hashlib.sha256(load_model("dis_rgb", operating_point=point).predict(*frames).tobytes()).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="needs the baseline x86-64 instruction set")
def test_oldest_instructions_give_the_same_bytes(tmp_path, capsys):
    oldest = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    there = subprocess.run(
        [sys.executable, "-c", BYTES], env=os.environ | oldest, capture_output=True, text=True, check=True
    ).stdout.split()
    exec(BYTES, {})
    here = capsys.readouterr().out.split()
    assert len(set(here)) == 4
    assert there == here
