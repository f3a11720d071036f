"""Whether a model that says nothing of itself is still the one whose rows a run holds."""

from __future__ import annotations

from collections.abc import Sequence
from math import isclose
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import RunError
from ..metrics.rows import CLEAN
from ..models import ModelSpec
from ..runs.plan import Unit
from ..runs.store import RunFolder
from .engines.base import Job
from .worker import Worker

_ANSWER = ("pred_magnitude_sum", "epe_sum", "n_invalid")
"""Columns of a clean row that another model's flow changes, the first also without ground truth."""
_TOLERANCE = 1e-3
"""Relative. More than a GPU's arithmetic differs from one run to the next, less than a change of a model."""


def check_same_model(folder: RunFolder, job: Job, keys: Sequence[str]) -> None:
    """Predict a clean pair of a run's again and compare its row.

    Two functions in one session, or two objects of one class, have the same name. Without an `identity()` only their
    answers tell them apart, and a run that was continued by another model would mix the rows of both.

    Args:
        folder: of the run.
        job: with the model that is to continue it, an object.
        keys: of the samples that can be loaded.

    Raises:
        RunError: the model answers otherwise than the one that the run was begun with.
    """
    rows = folder.rows()
    rows = rows.filter((rows["corruption"] == CLEAN) & rows["sample"].is_in(list(keys)))
    if rows.is_empty():
        return
    before = rows.row(0, named=True)
    assert not isinstance(job.model, ModelSpec)
    with TemporaryDirectory(prefix="robustflow-") as elsewhere:
        worker = Worker(job.dataset, job.model, job.options, lambda key: Path(elsewhere) / "clean.npy")
        (now,) = worker.run(Unit(before["sample"], CLEAN, (0,)))
    if not all(_same(now[column], before[column]) for column in _ANSWER):
        raise RunError(
            f"{folder.path} was begun by a model of the same name that answers otherwise on sample "
            f"'{before['sample']}'; choose another folder with output=, or give the models a method identity() that "
            "tells them apart"
        )


def _same(now: Any, before: Any) -> bool:
    return now == before or (None not in (now, before) and isclose(now, before, rel_tol=_TOLERANCE))
