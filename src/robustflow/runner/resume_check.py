"""Before a run continues: is this still the model, and are these still the data, that its rows were measured with?

An identity cannot say it all. A user's model counts with its own source file, not with what it imports or reads; data
count with the names and sizes of their files. So one clean row is measured again, of the sample whose files changed
last: frames and ground truth are compared always, the prediction unless the model is named by a hash of its content.
Every other sample is compared in the same way when its own work goes on (see `Worker`).
"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..metrics.rows import CLEAN
from ..runs.manifest import last_changed
from ..runs.plan import Plan, Unit
from ..runs.store import RunFolder
from ..sample import Flow, Frame
from .engines.base import Job
from .kept_rows import check_same_data, check_same_model, kept_clean_rows
from .worker import Worker

_HASH = re.compile(r"[0-9a-f]{64}")


def check_before_resuming(folder: RunFolder, job: Job, plan: Plan) -> None:
    """Measure one clean row of a run again and compare it; nothing where there is no row yet.

    Args:
        folder: of the run.
        job: that is to continue it.
        plan: of the job.

    Raises:
        RunError: other frames, another ground truth, or another prediction.
    """
    kept = kept_clean_rows(folder, plan.benchmark.keys)
    if not kept:
        return
    before = kept[last_changed(plan, kept)]
    with TemporaryDirectory(prefix="robustflow-") as elsewhere:

        def measured(model: Any) -> dict[str, Any]:
            worker = Worker(job.dataset, model, job.options, lambda key: Path(elsewhere) / "clean.npy")
            return worker.run(Unit(before["sample"], CLEAN, (0,)))[0]

        if job.options.window is None and is_named_by_content(plan.model_identity):
            check_same_data(before, measured(_Still()))
            return
        now = measured(job.load_model())
    check_same_data(before, now)
    check_same_model(before, now)


def is_named_by_content(identity: dict[str, Any]) -> bool:
    """Whether a model's identity holds the SHA-256 of its weights or files, and none of its code is a user's.

    >>> is_named_by_content({"name": "raft", "checkpoint": "ab" * 32})
    True
    >>> is_named_by_content({"spec": "mine:Net", "source": "ab" * 16, "checkpoint": "ab" * 32})
    False
    """
    users = "source" in identity or "object" in identity
    return not users and any(isinstance(value, str) and _HASH.fullmatch(value) for value in identity.values())


class _Still:
    """Stands in for a model that need not be asked: no motion."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        return np.zeros((*frame1.shape[:2], 2), np.float32)
