"""Fixtures: a small run, and the same run packed as a record."""

from __future__ import annotations

import pytest

from robustflow.api import Result, evaluate
from robustflow.run.records.pack import record_bytes


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Result:
    folder = tmp_path_factory.mktemp("record") / "run"
    return evaluate("farneback", "demo", output=folder, corruptions=["contrast", "fog"], severities=[1, 5])


@pytest.fixture(scope="session")
def packed(run) -> bytes:
    return record_bytes(run, author="Ada", link="https://example.org", description="A run.")
