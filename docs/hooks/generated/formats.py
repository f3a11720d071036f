"""The file formats that users read: rows, summary.json, manifest.json, records; fields and types from their
declarations.
"""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from robustflow.metrics import regions, rows, summary
from robustflow.run.records import contents

from .tables import table

_COLUMNS = {
    "sample": "The sample's key, the same on every machine.",
    "group": "Name shared by samples that are not independent (one video); otherwise the key itself.",
    "corruption": "Name of the corruption, or `clean`.",
    "severity": "1 to 5; 0 in the clean row.",
    "frames_digest": "Hash (BLAKE3, 16 bytes, hexadecimal) of the two frames that the model was given.",
    "truth_digest": "Hash (BLAKE3, 16 bytes, hexadecimal) of the ground truth: its mask and its vectors.",
    "height": "Height of the frames, pixels.",
    "width": "Width of the frames, pixels.",
    "truth": "What the corruption leaves of the ground truth: `unchanged`, or `none` if it moves content.",
    "n_invalid": "Pixels at which this row's prediction is not finite.",
    "n_all": "Usable pixels.",
    "rcre_all_sum": "Distance from the clean flow, summed over `n_all`, pixels.",
    "pred_magnitude_sum": "Length of the predicted flow, summed over `n_all`, pixels.",
    "n_photometric": "Pixels whose target according to the flow is inside the frame.",
    "photometric_sum": "Difference between clean frame 1 and warped clean frame 2 over `n_photometric`, grey levels.",
    "photometric_still_sum": "The same for zero flow, over the same pixels, grey levels.",
    "n_valid": "Usable pixels with ground truth.",
    "epe_sum": "End-point error, summed over `n_valid`, pixels.",
    "rcre_sum": "Distance from the clean flow, summed over `n_valid`, pixels.",
    "magnitude_sum": "Length of the true flow, summed over `n_valid`, pixels.",
    "fl_count": "Pixels of `n_valid` with an error above 3 px and above 5 % of the true length.",
    "px1_count": "Pixels of `n_valid` with an error above 1 px.",
    "px3_count": "Pixels of `n_valid` with an error above 3 px.",
    "px5_count": "Pixels of `n_valid` with an error above 5 px.",
    "wauc_sum": "Weighted area under the inlier curve, summed over `n_valid`; 1 for a perfect pixel.",
    "attack_linf": "Rows of attacks only: largest change of a value in the 8-bit frames, grey levels.",
    "attack_rms": "Rows of attacks only: root mean square of the change of the 8-bit frames, grey levels.",
    "attack_capped_sum": "Rows of attacks only: error, capped at the frame's diagonal, summed over `n_valid`, pixels.",
    "attack_median": "Rows of attacks only: median error over `n_valid`, pixels.",
    "attack_way_gone": "Rows of attacks only: share of the way from the clean flow to the attack's target.",
    "attack_late_gain": "Rows of attacks only: gain of the last quarter of the evaluations, in units of the loss.",
    "attack_start_spread": "Rows of attacks only: lead of the best start over the worst one, in units of the loss.",
    "attack_evaluations": "Rows of attacks only: number of flows that the attack requested from the model.",
    "attack_warnings": "Rows of attacks only: reasons why the row is doubtful, separated by commas.",
    "ause": "Runs with a confidence: area between its sparsification curve and the oracle's, pixels.",
    "confidence_spearman": "Runs with a confidence: rank correlation of confidence and error; -1 is best.",
    "rejected_count": "Runs with forward-backward confidence: pixels of `n_all` that the consistency check rejects.",
    **{
        f"{curve}_at_{share}": f"Runs with a confidence: mean error of the {share} % {of} pixels, pixels."
        for curve, of in (("error", "most confident"), ("oracle", "best"))
        for share in rows.COVERAGES
    },
    "spread_sum": "Runs with several draws: standard deviation of the flow over them, summed over `n_all`, pixels.",
    "n_truth": "Pixels with ground truth, predicted or not.",
    "clean_epe_sum": "Error of the clean prediction, summed over the same `n_valid` pixels, pixels.",
}
"""Contents of each column; columns of a region contain the same within it. A column without an entry
fails the build.
"""


def files() -> dict[str, str]:
    """Make the four pages."""
    return {
        "reference/rows.md": _rows(),
        "reference/summary.md": _summary(),
        "reference/manifest.md": _manifest(),
        "reference/record.md": _record(),
    }


def _rows() -> str:
    doc = inspect.getdoc(rows) or ""
    listed = []
    for name, dtype in rows.ROW_SCHEMA.items():
        region = next((r for r in regions.REGIONS if name.endswith(f"_{r}")), "")
        whole = name.removesuffix(f"_{region}") if region else name
        meaning = "Pixels of `n_valid` in the region." if whole == "n" else _COLUMNS[whole]
        if region and whole != "n":
            meaning = meaning.replace("`n_valid`", f"`n_{region}`")
        listed.append((f"`{name}`", dtype.__name__, region and f"`{region}`", meaning))
    return "\n\n".join(
        [
            "# Rows",
            "`RUN/rows/*.parquet`, `Result.rows`, and `rows.csv` of a record. "
            f"Schema version {rows.ROW_SCHEMA_VERSION}.",
            doc.partition("\n\n")[2],
            "## Columns",
            table(("column", "type", "region", "meaning"), listed),
            "No two rows of a run share " + ", ".join(f"`{name}`" for name in rows.ROW_KEY) + ".",
            "## Regions",
            _attributes_or_text(regions),
        ]
    )


def _summary() -> str:
    parts = [
        "# summary.json",
        f"The means of a run, version {summary.SUMMARY_VERSION}. In Python: `Result.summary` (as objects) and "
        "`Result.document()` (as in the file).",
        "The file contains the fields of the first table below and, in addition, `pooled` (the same means over the "
        "pixels of all images at once), the fields that identify the run, and its setting.",
    ]
    for model in (
        summary.Summary,
        summary.CorruptionScores,
        summary.Scores,
        summary.RegionScores,
        summary.MissingCells,
    ):
        parts += _model(model)
    return "\n\n".join(parts)


def _manifest() -> str:
    parts = [
        "# manifest.json",
        "The configuration of a run. A record contains the fields below; a run's folder also contains the command line "
        "and the machine's name and system, which `robustflow record pack` omits.",
    ]
    for model in (contents.Manifest, *_used_by(contents.Manifest)):
        parts += _model(model)
    return "\n\n".join(parts)


def _record() -> str:
    parts = [
        "# Records",
        f"`record.json` of a `.robustflow` file, version {contents.VERSION}. [The guide](../records.md) describes the "
        "other entries of the file, what `record verify` checks, and what it cannot show. See also "
        "[`manifest.json`](manifest.md), the [columns of `rows.csv`](rows.md) and [`summary.json`](summary.md).",
    ]
    for model in (contents.Record, contents.PackedEntry):
        parts += _model(model)
    return "\n\n".join(parts)


def _model(model: type[BaseModel]) -> list[str]:
    """A heading, the first sentence of the docstring, and the fields, including those of a base class."""
    doc = inspect.getdoc(model) or ""
    meanings: dict[str, str] = {}
    for base in reversed(model.__mro__):
        meanings |= attributes(base.__doc__ or "")
    listed = []
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else f"`{field.get_default()!r}`"
        listed.append((f"`{field.alias or name}`", f"`{type_name(field.annotation)}`", default, meanings.get(name, "")))
    filled = any(row[3] for row in listed)
    heading = ("field", "type", "default", "meaning") if filled else ("field", "type", "default")
    intro = doc.partition("\n\nAttributes:")[0]
    return [f"## {model.__name__}", intro, table(heading, [row if filled else row[:3] for row in listed])]


def _used_by(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """The models among the field types of a model, in order, each once."""
    seen: dict[type[BaseModel], None] = {}
    for field in model.model_fields.values():
        for kind in (field.annotation, *typing.get_args(field.annotation)):
            if inspect.isclass(kind) and issubclass(kind, BaseModel) and kind not in seen:
                seen[kind] = None
                yield kind
                yield from (each for each in _used_by(kind) if each not in seen)


def attributes(doc: str) -> dict[str, str]:
    """Meanings by name from the section "Attributes:" of a docstring."""
    section = inspect.cleandoc(doc).partition("Attributes:\n")[2].partition("\n\n")[0]
    out = {}
    for entry in re.split(r"\n    (?=\S)", "\n" + section):
        names, _, meaning = entry.partition(":")
        for name in names.split(","):
            if name.strip():
                out[name.strip()] = " ".join(meaning.split())
    return out


def type_name(kind: Any) -> str:
    """A type as written in Python."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return type_name(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return " | ".join(type_name(each) for each in arguments)
    if origin is typing.Literal:
        return " | ".join(repr(each) for each in arguments)
    if origin is not None:
        return f"{origin.__name__}[{', '.join(type_name(each) for each in arguments)}]"
    return "None" if kind is type(None) else str(getattr(kind, "__name__", kind))


def _attributes_or_text(module: Any) -> str:
    return inspect.getdoc(module) or ""
