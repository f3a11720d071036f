"""Test the variant "reference-bgr": the reference code's corruptions applied to frames in OpenCV's channel order."""

import numpy as np
import pytest

from robustflow.core.errors import UsageError
from robustflow.corruptions import IMAGE_PAIR, corrupt, load_corruption

FRAME = np.random.default_rng(3).integers(0, 256, (40, 56, 3), dtype=np.uint8)


@pytest.mark.parametrize("name", IMAGE_PAIR)
def test_bgr_variant_equals_the_reference_on_reversed_channels(name):
    turned = np.ascontiguousarray(FRAME[..., ::-1])
    bgr = corrupt(FRAME, FRAME, name, 4, 1, "k", variant="reference-bgr")
    reference = corrupt(turned, turned, name, 4, 1, "k", variant="reference")
    assert all((a == b[..., ::-1]).all() for a, b in zip(bgr, reference, strict=True))


@pytest.mark.parametrize("name", ["jpeg_compression", "psf_blur"])
def test_channel_order_changes_the_result_of_colour_dependent_corruptions(name):
    rgb, bgr = (corrupt(FRAME, FRAME, name, 3, variant=each) for each in ("reference", "reference-bgr"))
    assert not np.array_equal(rgb, bgr)


def test_severities_are_the_references_and_the_calibrated_scale_has_none():
    reference = load_corruption("saturate", "reference")
    assert load_corruption("saturate", "reference-bgr").severities == reference.severities
    with pytest.raises(UsageError):
        load_corruption("saturate", "reference-bgr", "calibrated")
    with pytest.raises(UsageError, match="reference-bgr"):
        load_corruption("saturate", "bgr")
