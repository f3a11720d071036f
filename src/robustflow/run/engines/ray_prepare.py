"""Prepare clips on a Ray cluster, one task per clip. All nodes write into the output folder, so they must share it."""

from __future__ import annotations

import os
import secrets
import socket
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...core.errors import DataError, RunError
from ...core.processes import rebuilt
from ...data.video.prepare import Preparation, Progress, prepare_clip
from ...data.video.source import Source
from .ray_actor import Answer, answered, begin_on_node, cannot_start, installed
from .ray_cluster import connected

_APPEARS_S = 10.0
"""Time limit for a file written on one machine to become visible on the others, in seconds."""


def prepare_on_ray(
    sources: Sequence[Source],
    output: Path,
    preparation: Preparation,
    progress: Progress,
    *,
    workers: int | None = None,
    address: str | None = None,
) -> None:
    """Prepare every clip in a folder of the same name in `output`, each with one CPU, or one GPU for FLAVR."""
    proof = output / f".shared-{secrets.token_hex(8)}"
    proof.touch()
    try:
        with connected(address, workers) as ray:
            resources = {"num_cpus": 1, "num_gpus": int(preparation.device.startswith("cuda"))}
            # a clip whose node is lost is prepared again
            task = ray.remote(_prepare).options(max_retries=2, scheduling_strategy="SPREAD", **resources)
            waiting, running, here = deque(sources), dict[Any, Source](), installed()
            try:
                while waiting or running:
                    while waiting and len(running) < (workers or len(sources)):
                        source = waiting.popleft()
                        call = task.remote(source, output / source.name, preparation, proof, os.getcwd(), here)
                        running[call] = source
                    for call in ray.wait(list(running), timeout=1.0)[0]:
                        source = running.pop(call)
                        _check_done(ray, call, source)
                        progress(source.name, "clips", len(sources) - len(waiting) - len(running), len(sources))
            finally:
                for call in running:
                    with suppress(Exception):  # the cluster may already be gone
                        ray.cancel(call, force=True)
    finally:
        proof.unlink(missing_ok=True)


def _check_done(ray: Any, call: Any, source: Source) -> None:
    try:
        kind, value = ray.get(call)
    except ray.exceptions.RayTaskError as error:
        raise cannot_start(error) from error
    except ray.exceptions.RayError as error:
        raise RunError(
            f"clip '{source.name}'",
            f"each process that prepared it crashed or was lost with its node ({type(error).__name__}); the usual "
            "causes are lack of memory on the nodes and a damaged video",
        ) from error
    if kind == "error":
        raise rebuilt(*value)


def _prepare(
    source: Source, folder: Path, preparation: Preparation, proof: Path, begins: str, wanted: dict[str, str]
) -> Answer:
    def prepare() -> None:
        begin_on_node({}, begins, [], wanted)
        deadline = time.monotonic() + _APPEARS_S
        while not proof.exists():
            if time.monotonic() > deadline:
                raise DataError(
                    f"node {socket.gethostname()}",
                    f"cannot see files that this machine writes to {proof.parent.absolute()}; choose an --output on a "
                    "file system that all nodes share under the same path",
                )
            time.sleep(0.1)
        prepare_clip(source, folder, preparation)

    return answered(prepare)
