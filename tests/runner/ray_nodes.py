"""A Ray cluster of several nodes on this machine. Its nodes can be killed, and it leaves no processes or files
behind."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

QUICK_HEALTH_CHECKS = {
    "RAY_health_check_initial_delay_ms": "0",
    "RAY_health_check_period_ms": "500",
    "RAY_health_check_failure_threshold": "2",
    "RAY_health_check_timeout_ms": "5000",  # a killed node is reported immediately; a busy one takes longer
    "RAY_USAGE_STATS_ENABLED": "0",
}
"""Make Ray detect a killed node within 2.5 s instead of 10 s."""


class Nodes:
    """A cluster with worker nodes and a head node that does not compute."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster

        self._cluster = Cluster(initialize_head=True, head_node_args=self._arguments(num_cpus=0))
        self.address = self._cluster.address
        self.alive: list[Any] = []

    def add(self, cpus: int = 1, gpus: int = 0, **more):
        node = self._cluster.add_node(**self._arguments(num_cpus=cpus, num_gpus=gpus), **more)
        self.alive.append(node)
        return node

    def kill(self, node) -> None:
        """Kill the node abruptly, like a power failure."""
        self._cluster.remove_node(node, allow_graceful=False)
        self.alive.remove(node)

    def end(self) -> None:
        self._cluster.shutdown()

    def _arguments(self, **more):
        return {"object_store_memory": 100 * 2**20, "include_dashboard": False, **more}


@contextmanager
def cluster(variables: dict[str, str] | None = None, **node: int) -> Iterator[Nodes]:
    """A cluster of two nodes for a test; `node` describes their resources."""
    pytest.importorskip("ray", reason="needs the ray extra")
    folder = tempfile.mkdtemp(prefix="rf-test-", dir="/tmp")  # a short path, for Ray's sockets
    nodes = None
    with pytest.MonkeyPatch.context() as patch:
        os.mkdir(f"{folder}/ray")
        patch.setenv("RAY_TMPDIR", folder)
        for name, value in {**QUICK_HEALTH_CHECKS, **(variables or {})}.items():
            patch.setenv(name, value)
        try:
            nodes = _started(folder, node)
            yield nodes
        finally:
            import ray

            ray.shutdown()
            if nodes is not None:
                nodes.end()
            left = still_running(folder)
            shutil.rmtree(folder, ignore_errors=True)
    assert not left, left


def _started(folder: str, node: dict[str, int]) -> Nodes:
    """Extend the 30 s that Ray allows for starting a node, which may be too short on a busy machine."""
    for attempts_left in (2, 1, 0):
        try:
            nodes = Nodes()
            nodes.add(**node)
            nodes.add(**node)
            return nodes
        except Exception as error:
            if "timed out during startup" not in str(error) or not attempts_left:
                raise
            for line in _running(folder):
                with suppress(ProcessLookupError):
                    os.kill(int(line.split()[0]), signal.SIGKILL)
    raise AssertionError


def descendants(root: int) -> dict[int, str]:
    """Command lines of a process's descendants, by process ID."""
    parents, lines = {}, {}
    for folder in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            lines[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    found, before = {root}, set()
    while found != before:
        before = set(found)
        found |= {child for child, parent in parents.items() if parent in before}
    return {number: lines[number] for number in found - {root} if number in lines}


def still_running(mark: str, within_s: float = 20.0) -> list[str]:
    """Command lines of the processes that contain `mark` and are still running after a while."""
    deadline = time.monotonic() + within_s
    while (left := _running(mark)) and time.monotonic() < deadline:
        time.sleep(0.2)
    return left


def _running(mark: str) -> list[str]:
    found = []
    for folder in Path("/proc").iterdir():
        try:
            line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if folder.name.isdecimal() and int(folder.name) != os.getpid() and mark in line:
            found.append(f"{folder.name} {line[:200]}")
    return found
