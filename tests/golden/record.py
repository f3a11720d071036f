"""Store golden runs: the digest of its identity, digests of its rows, and every mean."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl

import robustflow as rf
from robustflow.core.files import digest_of_bytes
from robustflow.corruptions import FAMILIES
from robustflow.metrics import METRICS, REGIONS
from robustflow.run.run import Run

from .runs import COMPARED, GOLDEN_RUNS

STORED = Path(__file__).parent / "runs.json"
Record = dict[str, Any]


def record(run: Run) -> Record:
    """Return the values of a run as JSON types."""
    return {
        "identity": run.manifest.identity_digest,
        "rows": dict(_row_digests(run)),
        "means": {" ".join(map(str, at)): value for *at, value in _means(run) if value is not None},
    }


def _row_digests(run: Run) -> Iterator[tuple[str, str]]:
    """Yield a digest of the rows of each condition; each null-free column counts, so that a new empty one does not."""
    rows = run.attack_rows if run.attacks else run.rows
    for (corruption, severity), part in sorted(rows.group_by("corruption", "severity")):
        values = part.sort("sample").select(column.name for column in part if column.null_count() < part.height)
        yield f"{corruption} {severity}", digest_of_bytes(values.write_csv().encode(), size=8)


def _means(run: Run) -> Iterator[tuple[Any, ...]]:
    """Yield (measure, condition, severity, value) of every mean; the severity is "-" for a mean over severities."""
    for condition in ("clean", "average", *FAMILIES, *run.measured.corruptions, *REGIONS):
        yield from ((metric, condition, "-", run.mean(metric, condition)) for metric in METRICS)
    for name, levels in run.measured.corruptions.items():
        yield from ((metric, name, level, run.mean(metric, name, level)) for metric in METRICS for level in levels)


def comparison(folder: Path) -> Record:
    """Return the numbers of a comparison of two runs: every column that is not text."""
    runs = [GOLDEN_RUNS[name].run(folder / str(number)) for number, name in enumerate(COMPARED)]
    frame = rf.compare(*runs).frame
    keys = [" ".join(map(str, key)) for key in frame.select("measure", "condition").iter_rows()]
    rows = frame.select(pl.selectors.numeric() - pl.selectors.by_name("severity")).iter_rows(named=True)
    return {key: {k: v for k, v in row.items() if v is not None} for key, row in zip(keys, rows, strict=True)}


def golden_text(folder: Path) -> str:
    """Measure everything again in an empty folder, and return the content of the stored file."""
    records = {name: record(golden.run(folder / name)) for name, golden in GOLDEN_RUNS.items()}
    return json.dumps(records | {"comparison": comparison(folder / "compared")}, indent=1) + "\n"
