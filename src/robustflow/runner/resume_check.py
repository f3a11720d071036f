"""Check, before a run continues, that the model and the data are unchanged since its rows were measured.

An identity does not cover everything: for a user's model it includes the source file, but no imported modules or other
files; for data, only the names and sizes of files. So one clean row is measured again, for the sample with the most
recently changed files. Frames and ground truth are always compared; the prediction is compared unless the model is
identified by a hash of its content. All other samples are compared in the same way when their units continue (see
`Worker`).
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from ..metrics.rows import CLEAN
from ..runs.open_manifest import last_changed
from ..runs.plan import Plan, Unit
from ..runs.store import RunFolder
from .clean_row_check import check_same_data, check_same_model, stored_clean_rows
from .engines.base import Job
from .worker import NoMotion, temporary_worker

_HASH = re.compile(r"[0-9a-f]{64}")


def check_before_resuming(folder: RunFolder, job: Job, plan: Plan) -> None:
    """Measure one clean row of a run again and compare it; do nothing if there is no row yet."""
    stored = stored_clean_rows(folder, plan.benchmark.keys)
    if not stored:
        return
    before = stored[last_changed(plan, stored)]
    only_data = job.options.window is None and is_named_by_content(plan.model_identity)
    model = NoMotion() if only_data else job.load_model()
    options = replace(job.options, confidence=None) if only_data else job.options
    with temporary_worker(job.dataset, model, options) as worker:
        (now,) = worker.run(Unit(before["sample"], CLEAN, (0,)))
    check_same_data(before, now)
    if not only_data:
        check_same_model(before, now)


def is_named_by_content(identity: dict[str, Any]) -> bool:
    """Return whether a model's identity includes the SHA-256 of its weights or files, and the model has no user
    code.
    """
    users = "source" in identity or "object" in identity
    return not users and any(isinstance(value, str) and _HASH.fullmatch(value) for value in identity.values())
