"""Fixtures: one app for all tests of a process."""

import pytest

from .launch import SCRIPTED, running_app, with_demo


@pytest.fixture(scope="session", autouse=True)
def _installed():
    """Skip the test if the app is not installed."""
    for name in ("starlette", "uvicorn", "python_multipart"):
        pytest.importorskip(name, reason="the app extra is not installed")


@pytest.fixture(scope="session")
def app(tmp_path_factory, small_demo):
    """A running app with the small demo pair, which offers a scripted model first."""
    with running_app(tmp_path_factory.mktemp("app"), "--model", SCRIPTED, start=with_demo(small_demo)) as running:
        yield running
