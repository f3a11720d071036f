"""A Ray cluster of several nodes on this machine. Its nodes can be killed, and it leaves no processes or files
behind."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from .processes import running, still_running

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
        self.engine = {"engine": "ray", "address": self.address}
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
            for line in running(folder):
                with suppress(ProcessLookupError):
                    os.kill(int(line.split()[0]), signal.SIGKILL)
    raise AssertionError
