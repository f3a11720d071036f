"""What a worker process finds in its environment."""

from __future__ import annotations

import os

import pytest

from robustflow.runner.engines.child import Child, worker_environment

NAMES = ("OMP_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_")


def _tell(pipe):
    pipe.send(("environment", [os.environ.get(name) for name in NAMES]))


@pytest.mark.parametrize("mine", [None, "4096"])
def test_one_thread_each_and_memory_is_kept_unless_the_user_decided_that(monkeypatch, mine):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    if mine is not None:
        monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", mine)
    kept = worker_environment()["MALLOC_TRIM_THRESHOLD_"]
    assert kept == mine if mine else int(kept) > 2**20
    child = Child(_tell)
    try:
        assert child.receive("nothing", "") == ("environment", ["1", kept])
    finally:
        child.end()
    assert [os.environ.get(name) for name in NAMES] == ["7", mine], "that of this process is as before"
