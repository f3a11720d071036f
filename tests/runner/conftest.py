"""Frames for small runs, and worker processes that start quickly."""

import pytest

from robustflow.images.io import write_image

from ..corruptions.pictures import picture
from ..prepared_processes import get_context, prepare

FRAMES = 6
"""Number of frames in `clip_folder`."""
FAST = ("contrast", "high_light", "over_exposure", "impulse_noise")
"""Corruptions that take a few milliseconds."""


@pytest.fixture(scope="session")
def _prepared_process():
    prepare()


@pytest.fixture
def quick_workers(_prepared_process, monkeypatch):
    """Fork the workers of runs from a process that has already imported the package."""
    monkeypatch.setattr("multiprocessing.get_context", get_context)


@pytest.fixture(scope="session")
def clip_folder(tmp_path_factory):
    """A sequence of textured frames in which every pixel has a unique neighbourhood."""
    folder = tmp_path_factory.mktemp("frames")
    for number in range(FRAMES):
        write_image(folder / f"{number}.png", picture(48, 64, seed=number))
    return folder
