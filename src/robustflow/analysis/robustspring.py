"""How far a model's flow moves on RobustSpring, as results that a leaderboard shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import fsum
from typing import Any

import polars as pl

from ..runs.run import Run
from ..text import counted
from .results import AVERAGE, RESULT_SCHEMA
from .scores import OWN

BENCHMARK = "RobustSpring"


def robustspring_results(run: Run, moved: Mapping[str, Sequence[float]]) -> pl.DataFrame:
    """RCRE per corruption and their mean: columns of `results.RESULT_SCHEMA`.

    Args:
        run: whose model predicted.
        moved: corruption -> of each pair the mean distance between corrupted and clean flow, pixels.
    """
    means = {name: fsum(values) / len(values) for name, values in moved.items()}
    means[AVERAGE] = fsum(means.values()) / len(means)
    pairs = min(len(values) for values in moved.values())
    note = f"{counted(pairs, 'pair')}, all pixels; average over {counted(len(moved), 'corruption')}"
    head = (BENCHMARK, _setting(run.manifest), run.name, "rcre")
    source = str(run.manifest["identity_digest"])
    lines = [(*head, name, value, None, None, source, f"RobustSpring, {note}", note) for name, value in means.items()]
    return pl.DataFrame(lines, schema=RESULT_SCHEMA, orient="row")


def _setting(manifest: Mapping[str, Any]) -> str:
    """RobustSpring is Spring's test sequences: a model trained on its training sequences knows only the domain."""
    record = manifest.get("provenance") or {}
    if record.get("setting") in ("knowledge", "untrained"):
        return str(record["setting"])
    if record.get("trained_on") is None:
        return OWN
    return "ID" if any(str(name).partition(":")[0] == "spring" for name in record["trained_on"]) else "OOD"
