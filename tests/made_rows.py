"""Rows that a test writes by hand, with what follows from the others filled in, and runs of such rows."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

import polars as pl

from robustflow.digest import digest_of_bytes
from robustflow.metrics.regions import REGIONS
from robustflow.metrics.rows import CLEAN, ROW_SCHEMA
from robustflow.metrics.rows import rows_frame as frame_of
from robustflow.runs.identity import identity_digest
from robustflow.runs.run import Run

_CLEAN_SUMS = {
    "epe_sum": "n_valid",
    **{f"epe_sum_{region}": f"n_{region}" for region in REGIONS},
}


def rows_frame(rows: Iterable[dict[str, Any]]) -> pl.DataFrame:
    """The columns of `ROW_SCHEMA`: the clean error's sums are those of the sample's clean row, every pixel with ground
    truth is predicted, and the digests are of the sample and the condition, where a row does not give them."""
    rows = [dict.fromkeys(ROW_SCHEMA) | row for row in rows]
    clean = {row["sample"]: row for row in rows if row["corruption"] == CLEAN}
    return frame_of(_filled(row, clean.get(row["sample"], {})) for row in rows)


def _filled(row: dict[str, Any], clean: dict[str, Any]) -> dict[str, Any]:
    follows = {f"clean_{total}": clean.get(total) for total, count in _CLEAN_SUMS.items() if row[count] is not None}
    follows["frames_digest"] = f"{row['sample']} {row['corruption']} {row['severity']}"
    if row["n_valid"] is not None:
        follows |= {"n_truth": row["n_valid"], "truth_digest": f"truth of {row['sample']}"}
    return row | {name: value for name, value in follows.items() if row[name] is None}


def made_run(base: Run, rows: pl.DataFrame, model: str | dict[str, Any] = "model", **identity: Any) -> Run:
    """A run of imaginary rows: the manifest of `base`, with the model and the parts of the identity that are given.

    Args:
        base: any run.
        rows: of the made one; its corruptions and severities count as those that were requested.
        model: its name, or its whole identity.
    """
    run = Run(base.path)
    manifest = copy.deepcopy(base.manifest)
    manifest["identity"] |= {"model": {"name": model} if isinstance(model, str) else model} | identity
    manifest["identity_digest"] = identity_digest(manifest["identity"])
    manifest["samples"] = {key: [] for key in rows["sample"].unique(maintain_order=True)}
    dirty = rows.filter(pl.col("corruption") != CLEAN)
    manifest["selection"] = {
        "corruptions": sorted(dirty["corruption"].unique()),
        "severities": sorted(dirty["severity"].unique()),
    }
    run.manifest, run.rows = manifest, rows
    run.rows_digest = digest_of_bytes(rows.write_csv().encode())  # what is kept with the folder is not about these rows
    return run
