"""Worker processes reuse the memory that they free."""

import resource

import numpy as np
import pytest

from robustflow.core.processes import Child

FRAMES = (375, 1242, 3)


def _faults_of_repeated_frames(pipe):
    """Number of page faults while frames are allocated and released, not counting the first frames."""
    before = 0
    for number in range(60):
        if number == 20:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        frames = [np.full(FRAMES, number, np.uint8) for _ in range(2)]
        del frames
    pipe.send(("faults", resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before))


def _faults() -> int:
    child = Child(_faults_of_repeated_frames)
    try:
        return child.receive("nothing", "", "")[1]
    finally:
        child.end()


def test_frames_reuse_the_memory_of_earlier_ones():
    pages = 40 * 2 * int(np.prod(FRAMES)) // 4096
    assert _faults() < pages / 10


@pytest.mark.parametrize("name", ["MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"])
def test_malloc_variables_set_by_the_user_take_precedence(monkeypatch, name):
    monkeypatch.setenv(name, "65536")
    pages = 40 * 2 * int(np.prod(FRAMES)) // 4096
    assert _faults() > pages / 2
