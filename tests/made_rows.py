"""Hand-written rows, with dependent columns filled in, and runs made of them."""

import json
from collections.abc import Iterable
from typing import Any

import polars as pl

from robustflow.core.files import digest_of_bytes
from robustflow.metrics.regions import REGIONS
from robustflow.metrics.rows import CLEAN, ROW_SCHEMA
from robustflow.metrics.rows import rows_frame as frame_of
from robustflow.run.identity import FrameIdentity, Identity
from robustflow.run.manifest import Cells
from robustflow.run.run import Run

_CLEAN_SUMS = {
    "epe_sum": "n_valid",
    **{f"epe_sum_{region}": f"n_{region}" for region in REGIONS},
}


def rows_frame(rows: Iterable[dict[str, Any]]) -> pl.DataFrame:
    """Add the missing columns of `ROW_SCHEMA`. Clean sums are copied from the sample's clean row, every pixel with
    ground truth counts as predicted, and digests are derived from the sample and the condition.
    """
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
    """A run with invented rows. Its manifest is that of `base`, except for the given model and parts of the identity.

    Args:
        base: any run.
        rows: rows of the new run; their corruptions and severities become the requested ones.
        model: name of the model, or its complete identity.
    """
    run = Run(base.path)
    change_identity(run, {"name": model} if isinstance(model, str) else model, **identity)
    change_plan(run, rows)
    run.rows = rows
    run.rows_digest = digest_of_bytes(rows.write_csv().encode())  # other files of the folder do not describe these rows
    return run


def change_manifest(run: Run, **fields: Any) -> None:
    """Replace fields of the manifest that a run keeps in memory."""
    run.manifest = run.manifest.model_copy(update=fields)
    run.__dict__.pop("provenance", None)


def change_plan(run: Run, rows: pl.DataFrame) -> None:
    """Replace the plan in memory with every sample in the rows under every corruption and severity in them."""
    dirty = rows.filter(pl.col("corruption") != CLEAN)
    samples = tuple(rows["sample"].unique(maintain_order=True))
    levels = tuple(sorted(dirty["severity"].unique()))
    planned = Cells(samples=samples, corruptions=dict.fromkeys(sorted(dirty["corruption"].unique()), levels))
    change_manifest(run, samples=dict.fromkeys(samples, ()), planned=(planned,))


def change_identity(run: Run, model: dict[str, Any] | None = None, **fields: Any) -> None:
    """Replace the model's settings, and fields of the identity by name, and update the digest."""
    identity = changed_identity(run.manifest.identity, model, **fields)
    change_manifest(run, identity=identity, identity_digest=identity.digest())


def changed_identity(identity: Identity, model: dict[str, Any] | None = None, **fields: Any) -> Identity:
    """An identity with different settings of the model, or different values of fields in any part."""
    content = identity.record()
    if model is not None:
        content["model"]["settings"] = model
    for name, value in fields.items():
        part = "frames" if name in FrameIdentity.model_fields else "model" if name == "window" else "measuring"
        content[part][name] = value
    return Identity.model_validate_json(json.dumps(content))
