"""Test the variant "reference-bgr": the reference code's corruptions applied to frames in OpenCV's channel order."""

import cv2
import numpy as np
import pytest
from PIL import Image

from robustflow.corruptions import IMAGE_PAIR, corrupt, load_corruption
from robustflow.errors import UsageError

FRAME = np.random.default_rng(3).integers(0, 256, (40, 56, 3), dtype=np.uint8)


def test_jpeg_is_what_pillow_writes_of_a_bgr_frame(tmp_path):
    """Return the reference result: Image.fromarray(cv2.imread(...)), saved as JPEG, read, and written by
    cv2.imwrite.
    """
    bgr = np.ascontiguousarray(FRAME[..., ::-1])
    for severity, quality in enumerate((25, 18, 15, 10, 7), 1):
        Image.fromarray(bgr).save(tmp_path / "x.jpg", quality=quality)
        written = np.asarray(Image.open(tmp_path / "x.jpg"))[..., ::-1]
        assert (corrupt(FRAME, FRAME, "jpeg_compression", severity, variant="reference-bgr")[0] == written).all()


@pytest.mark.parametrize("name", [name for name in IMAGE_PAIR if name != "psf_blur"])
def test_it_is_the_reference_on_reversed_channels(name):
    turned = np.ascontiguousarray(FRAME[..., ::-1])
    bgr = corrupt(FRAME, FRAME, name, 4, 1, "k", variant="reference-bgr")
    reference = corrupt(turned, turned, name, 4, 1, "k", variant="reference")
    assert all((a == b[..., ::-1]).all() for a, b in zip(bgr, reference, strict=True))


def test_mud_is_blue():
    grey = np.full((200, 300, 3), 128, np.uint8)
    spattered = corrupt(grey, grey, "spatter", 5, variant="reference-bgr")[0].reshape(-1, 3).astype(int)
    mud = spattered[np.abs(spattered - 128).max(1) > 60].mean(0)
    assert mud[2] > mud[0] + 20


def test_severities_are_the_references_and_the_calibrated_scale_has_none():
    assert (
        load_corruption("saturate", "reference-bgr").severities == load_corruption("saturate", "reference").severities
    )
    with pytest.raises(UsageError):
        load_corruption("saturate", "reference-bgr", "calibrated")
    with pytest.raises(UsageError, match="reference-bgr"):
        load_corruption("saturate", "bgr")


def test_the_order_matters_most_where_colours_are_treated_apart():
    frame = cv2.GaussianBlur(FRAME, (0, 0), 3)
    differs = {
        name: int(np.abs(a.astype(int) - b).max())
        for name in ("jpeg_compression", "psf_blur", "gaussian_blur", "pixelate")
        for a, b in [(corrupt(frame, frame, name, 3, variant=v)[0] for v in ("reference", "reference-bgr"))]
    }
    assert differs["jpeg_compression"] > 0
    assert differs["psf_blur"] > 0
    assert differs["gaussian_blur"] == differs["pixelate"] == 0
