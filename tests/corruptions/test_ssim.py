"""Compare SSIM with a naive float64 loop and with the definition in the reference folder."""

import importlib.util

import cv2
import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.corruptions.calibration import Ssim
from robustflow.media.images import read_image


def naive_ssim(a, b):
    """Compute the SSIM of one window at a time, using the formula (Wang et al. 2004, Eq. 13)."""
    x, y = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64) for image in (a, b))
    line = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weights = np.outer(line, line) / line.sum() ** 2
    padded = [np.pad(image, 5, mode="reflect") for image in (x, y)]
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    values = []
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            p, q = (image[i : i + 11, j : j + 11] for image in padded)
            mp, mq = (weights * p).sum(), (weights * q).sum()
            vp, vq = (weights * (p - mp) ** 2).sum(), (weights * (q - mq) ** 2).sum()
            cov = (weights * (p - mp) * (q - mq)).sum()
            values.append((2 * mp * mq + c1) * (2 * cov + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    return np.mean(values)


@pytest.mark.parametrize("shape", [(24, 31), (11, 16), (7, 40)])
@pytest.mark.parametrize("deviation", [2.0, 30.0, 200.0])
def test_a_naive_loop_agrees(shape, deviation):
    rng = np.random.default_rng(3)
    frame = cv2.GaussianBlur(rng.integers(0, 256, (*shape, 3)).astype(np.uint8), (3, 3), 1.0)
    other = np.clip(frame + rng.normal(0, deviation, frame.shape), 0, 255).astype(np.uint8)
    assert Ssim(frame)(other) == pytest.approx(naive_ssim(frame, other), abs=1e-9)
    assert Ssim(frame)(frame) == 1.0


def test_the_definition_of_the_reference_folder_agrees(shared):
    folder = shared("corruption-reference")
    spec = importlib.util.spec_from_file_location("metrics_def", folder / "metrics_def.py")
    assert spec is not None
    assert spec.loader is not None
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    frame1, frame2 = read_image(folder / "clean_1.png"), read_image(folder / "clean_2.png")
    assert Ssim(frame1)(frame2) == pytest.approx(reference.ssim(frame1, frame2), abs=2e-5)


def test_images_of_two_sizes_are_refused():
    with pytest.raises(DataError, match="8x12"):
        Ssim(np.zeros((8, 12, 3), np.uint8))(np.zeros((8, 13, 3), np.uint8))
