"""The values in the paper's appendix "Corruption Details", copied by hand so that errors in the classes are
detected.
"""

import pytest

from robustflow.corruptions import load_corruption

PAPER = {
    "jpeg_compression": (25, 18, 15, 10, 7),
    "pixelate": (0.6, 0.5, 0.4, 0.3, 0.25),
    "contrast": (0.4, 0.3, 0.2, 0.1, 0.05),
    "saturate": ((0.1, 0), (0.3, 0), (2, 0), (5, 0.1), (20, 0.2)),
    "high_light": (0.1, 0.2, 0.3, 0.4, 0.5),
    "low_light": (0.1, 0.2, 0.3, 0.4, 0.5),
    "over_exposure": (0.4, 0.8, 1.2, 1.6, 2.0),
    "under_exposure": (-0.4, -0.8, -1.2, -1.6, -2.0),
    "gaussian_noise": (0.08, 0.12, 0.18, 0.26, 0.38),
    "shot_noise": (60, 25, 12, 5, 3),
    "impulse_noise": (0.03, 0.06, 0.09, 0.17, 0.27),
    "gaussian_blur": (1, 2, 3, 4, 6),
    "glass_blur": ((0.7, 1, 2), (0.9, 2, 1), (1, 2, 3), (1.1, 3, 2), (1.5, 4, 2)),
    "camera_motion_blur": ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15)),
    "psf_blur": (0.0296, 0.0832, 0.1102, 0.1588, 0.1939),
    "h264_crf": (23, 30, 37, 44, 51),
    "h264_abr": (25e6, 12.5e6, 6.25e6, 3.125e6, 1.5625e6),
    "bit_error": (50e6, 25e6, 15e6, 10e6, 1e6),
}
DEFOCUS_RADII = (3, 4, 6, 8, 10)
CODE = {
    "spatter": (
        (0.65, 0.3, 4, 0.69, 0.6, False),
        (0.65, 0.3, 3, 0.68, 0.6, False),
        (0.65, 0.3, 2, 0.68, 0.5, False),
        (0.65, 0.3, 1, 0.65, 1.5, True),
        (0.67, 0.4, 1, 0.65, 1.5, True),
    ),
    "fog": ((1.5, 2), (2, 2), (2.5, 1.7), (2.5, 1.5), (3, 1.4)),
    "frost": ((1, 0.4), (0.8, 0.6), (0.7, 0.7), (0.65, 0.7), (0.6, 0.75)),
    "snow": (
        (0.1, 0.3, 3, 0.5, 10, 4, 0.8),
        (0.2, 0.3, 2, 0.5, 12, 4, 0.7),
        (0.55, 0.3, 4, 0.9, 12, 8, 0.7),
        (0.55, 0.3, 4.5, 0.85, 12, 8, 0.65),
        (0.55, 0.3, 2.5, 0.85, 12, 12, 0.55),
    ),
}
"""Parameters from the reference code that are not listed in the paper."""


@pytest.mark.parametrize("name", [*PAPER, *CODE])
def test_severities_equal_the_listed_parameters(name):
    assert load_corruption(name).severities == (PAPER | CODE)[name]


def test_radii_of_defocus_blur_equal_the_paper():
    assert tuple(level.radius for level in load_corruption("defocus_blur").severities) == DEFOCUS_RADII
