"""A run shared by the attack tests."""

import pytest

from .small_runs import run


@pytest.fixture(scope="session")
def both(tmp_path_factory):
    return run(tmp_path_factory.mktemp("runs") / "both", corruptions=["contrast", "high_light"])
