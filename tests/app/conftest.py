"""Fixtures: one app for all tests of a process."""

import pytest

from .launch import SCRIPTED, running_app


@pytest.fixture(scope="session", autouse=True)
def _installed():
    """Skip the test if the app is not installed."""
    for name in ("starlette", "uvicorn", "python_multipart"):
        pytest.importorskip(name, reason="the app extra is not installed")


@pytest.fixture(scope="session")
def app(tmp_path_factory):
    """A running app that offers a scripted model first."""
    with running_app(tmp_path_factory.mktemp("app"), "--model", SCRIPTED) as running:
        yield running
