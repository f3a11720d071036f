"""Measure a clean row again and compare it with the stored one, to detect changed frames, ground truth or model."""

from __future__ import annotations

from collections.abc import Iterable
from math import isclose
from typing import Any

import polars as pl

from ..errors import RunError
from ..metrics.rows import CLEAN
from ..runs.store import RunFolder

_FRAMES = ("frames_digest", "height", "width")
_PREDICTION = ("pred_magnitude_sum", "photometric_sum", "epe_sum", "n_invalid")
"""Columns that depend on the model; the first two do not need ground truth."""
_TOLERANCE = 1e-3
"""Relative tolerance: larger than the rounding differences between two runs on a GPU, smaller than the effect of a
changed model."""

KEPT = ("sample", "corruption", "severity", *_FRAMES, "truth_digest", *_PREDICTION)
"""Columns that are compared."""


def stored_clean_rows(folder: RunFolder, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the clean rows that a run already has for these samples, by sample and with only the columns in `KEPT`."""
    samples = set(keys)
    if not samples:
        return {}
    rows = folder.rows(KEPT, CLEAN).filter(pl.col("sample").is_in(list(samples)))
    return {row["sample"]: row for row in rows.iter_rows(named=True)}


def check_same_data(before: dict[str, Any], now: dict[str, Any]) -> None:
    """Compare the columns that depend on frames and ground truth."""
    if any(before[column] != now[column] for column in _FRAMES):
        raise _data_differ(before["sample"], "frames")
    if before["truth_digest"] != now["truth_digest"]:
        raise _data_differ(before["sample"], "ground truth")


def check_same_model(before: dict[str, Any], now: dict[str, Any]) -> None:
    """Compare the columns that depend on the model."""
    if not all(_close(before[column], now[column]) for column in _PREDICTION):
        raise RunError(
            f"the model predicts a different flow on sample '{before['sample']}' than when this run measured it, "
            "although the model's name is the same: its code, a module that it imports or its weights have changed; "
            "choose a different folder with --output, or restore the model"
        )


def _data_differ(key: str, what: str) -> RunError:
    return RunError(
        f"sample '{key}' has different {what} than when this run measured it, although the names and sizes "
        "of its files are the same; restore the data, or choose a different folder with --output"
    )


def _close(before: float | None, now: float | None) -> bool:
    if before is None or now is None:
        return before is now
    return before == now or isclose(before, now, rel_tol=_TOLERANCE)
