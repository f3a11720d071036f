"""Describe what a node needs for a job: a GPU if required, the model, and the data files."""

from __future__ import annotations

import os

from ...child import ONE_THREAD
from ...corruptions.stack import needs_depth
from ...errors import UsageError
from ...models import ModelSpec
from ...models.devices import device_of, is_accelerator
from ...runs.plan import Unit
from ...runs.sample_files import files_of_sample
from .base import Job


def needs_gpu(job: Job) -> bool:
    """Return whether every actor needs its own GPU."""
    listed = job.model.devices() if isinstance(job.model, ModelSpec) else ()
    if any(":" in device for device in listed):
        raise UsageError(
            f"--device {','.join(listed)} is not available with the ray engine: use --device cuda; Ray assigns each "
            "worker its own GPU"
        )
    return is_accelerator(listed[0] if listed and listed[0] != "auto" else device_of(job.load_model()))


def files_of(job: Job, unit: Unit) -> tuple[tuple[str, int], ...]:
    """Return paths and sizes of the files that a node needs for a unit; depth files are included only if its corruption
    needs depth."""
    options, attacked = job.options, unit.corruption in job.options.attacks
    depths = None if attacked or not needs_depth(unit.corruption) else options.depth
    files = files_of_sample(job.dataset, unit.key, options.window, depths)
    return tuple((str(path), path.stat().st_size) for path in files)


def variables() -> dict[str, str]:
    """Return environment variables for every actor: the paths of the user's files, and one thread per library."""
    settings = {name: value for name, value in os.environ.items() if name.startswith("ROBUSTFLOW_")}
    return settings | ONE_THREAD
