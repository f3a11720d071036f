"""Fixtures: one app for all tests of a process."""

import pytest

from .launch import running_app


@pytest.fixture(scope="session", autouse=True)
def _installed():
    """Skip the test if the app is not installed."""
    for name in ("starlette", "uvicorn", "python_multipart"):
        pytest.importorskip(name, reason="the app extra is not installed")


@pytest.fixture(scope="session")
def app(tmp_path_factory):
    """A running app that offers a slow model first."""
    with running_app(tmp_path_factory.mktemp("app"), "--model", "models_for_app:Slow") as running:
        yield running


@pytest.fixture(scope="session")
def failing_app(tmp_path_factory):
    """A running app whose model raises an exception."""
    with running_app(tmp_path_factory.mktemp("failing"), "--model", "models_for_app:Fails") as running:
        yield running
