"""Small runs on the embedded pair."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

FAST = ("contrast", "high_light", "over_exposure", "impulse_noise")
"""Corruptions that cost a few milliseconds."""


@pytest.fixture
def models_on_path(monkeypatch):
    """Make `models_for_tests:...` importable, here and in worker processes."""
    folder = str(Path(__file__).parent)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", folder)
    yield
    sys.modules.pop("models_for_tests", None)
