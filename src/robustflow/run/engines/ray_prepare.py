"""Prepare clips on a Ray cluster, one task per clip. All nodes write into the output folder, so they must share it."""

from __future__ import annotations

import os
import secrets
import socket
import time
from collections import Counter, deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...core.errors import DataError, RunError
from ...core.processes import rebuilt
from ...data.video.prepare import Preparation, Progress, prepare_clip
from ...data.video.source import Source
from .ray_actor import Answer, answered, cannot_start, check_installed, installed
from .ray_cluster import connected

ATTEMPTS = 3
"""Maximum number of nodes that may be lost while preparing the same clip."""
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
            gpu = int(preparation.device.startswith("cuda"))
            task = ray.remote(_prepare).options(num_cpus=1, num_gpus=gpu, max_retries=0, scheduling_strategy="SPREAD")
            waiting, losses, running = deque(sources), Counter[str](), dict[Any, Source]()
            here, finished = installed(), 0
            try:
                while waiting or running:
                    while waiting and len(running) < (workers or len(sources)):
                        source = waiting.popleft()
                        call = task.remote(source, output / source.name, preparation, proof, os.getcwd(), here)
                        running[call] = source
                    for call in ray.wait(list(running), timeout=1.0)[0]:
                        source = running.pop(call)
                        if _is_done(ray, call, source, losses):
                            finished += 1
                            progress(source.name, "clips", finished, len(sources))
                        else:
                            waiting.append(source)
            finally:
                for call in running:
                    with suppress(Exception):  # the cluster may already be gone
                        ray.cancel(call, force=True)
    finally:
        proof.unlink(missing_ok=True)


def _is_done(ray: Any, call: Any, source: Source, losses: Counter[str]) -> bool:
    """Return whether a clip is finished; False if its node was lost."""
    try:
        kind, value = ray.get(call)
    except ray.exceptions.RayTaskError as error:
        raise cannot_start(error) from error
    except ray.exceptions.RayError as error:
        losses[source.name] += 1
        if losses[source.name] == ATTEMPTS:
            raise RunError(
                f"clip '{source.name}'",
                f"lost {ATTEMPTS} times with the node that prepared it ({type(error).__name__}); lack of memory is the "
                "usual cause: try fewer --workers",
            ) from error
        return False
    if kind == "error":
        raise rebuilt(*value)
    return True


def _prepare(
    source: Source, folder: Path, preparation: Preparation, proof: Path, begins: str, wanted: dict[str, str]
) -> Answer:
    host = socket.gethostname()

    def prepare() -> None:
        check_installed(host, wanted, installed())
        if os.path.isdir(begins):
            os.chdir(begins)
        deadline = time.monotonic() + _APPEARS_S
        while not proof.exists():
            if time.monotonic() > deadline:
                raise DataError(
                    f"node {host}",
                    f"cannot see files that this machine writes to {proof.parent.absolute()}; choose an --output on a "
                    "file system that all nodes share under the same path",
                )
            time.sleep(0.1)
        prepare_clip(source, folder, preparation)

    kind, value = answered(prepare)
    if kind == "error":
        name, message, *rest = value
        value = name, message if f"node {host}" in message else f"{message} (on node {host})", *rest
    return kind, value
