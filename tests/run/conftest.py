"""Frames and corruptions for small runs."""

import pytest

from robustflow.media.images import write_image

from ..corruptions.pictures import picture

FRAMES = 6
"""Number of frames in `clip_folder`."""
FAST = ("contrast", "high_light", "over_exposure", "impulse_noise")
"""Corruptions that take a few milliseconds."""
SMALLEST = {"corruptions": ["contrast"], "severities": [1]}
"""Conditions of the smallest run."""


@pytest.fixture(scope="session")
def clip_folder(tmp_path_factory):
    """A sequence of textured frames in which every pixel has a unique neighbourhood."""
    folder = tmp_path_factory.mktemp("frames")
    for number in range(FRAMES):
        write_image(folder / f"{number}.png", picture(48, 64, seed=number))
    return folder
