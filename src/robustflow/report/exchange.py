"""Export a run to other programs: as Hugging Face evaluation results (`.eval_results/*.yaml` in a model's repository,
which the Hub shows), and as Croissant metadata (the rows as a dataset for search engines and loaders).

Exports are deterministic, so `check_exported` can compare a file with the run's record byte for byte.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from operator import eq
from pathlib import Path, PurePosixPath
from typing import Any

import polars as pl

from ..core.errors import RunError, UsageError, unknown_name
from ..core.files import json_bytes, read_bounded
from ..core.text import counted, file_name, plain
from ..data.benchmarks import benchmark_facts
from ..metrics.rows import ROW_SCHEMA
from ..run.records.format import rows_to_text
from ..run.records.read import Reader
from ..run.run import Run
from ..stats.exclusion import exclusion_reasons
from ..stats.frame import results_frame
from ..stats.results import AVERAGE, CLEAN, RESULT_METRICS, SETTING_EXPLANATIONS, SETTING_LABELS
from ..stats.run_results import comparison_note

Files = dict[PurePosixPath, bytes]
"""Contents by path relative to the folder of the export."""
EXCHANGE_FORMATS = ("croissant", "huggingface")
HUB_NAME = r"[A-Za-z0-9_.-]{1,96}/[A-Za-z0-9_.-]{1,96}"


def exchange_files(run: Run, format: str, hub_dataset: str | None = None) -> Files:
    """Export a run in one of the formats; return file contents by relative path."""
    if format not in EXCHANGE_FORMATS:
        raise unknown_name("exchange format", format, EXCHANGE_FORMATS)
    if format == "croissant":
        return _croissant_files(run)
    if hub_dataset is None or not re.fullmatch(HUB_NAME, hub_dataset):
        raise UsageError(
            "--hub-dataset", "--format huggingface needs the benchmark's dataset on the Hub, ORGANISATION/NAME"
        )
    return _huggingface_files(run, hub_dataset)


def _means(run: Run) -> list[dict[str, Any]]:
    """Return the clean EPE and the averages of a run, with intervals, as rows of the results frame."""
    frame = results_frame([run], ("means",))
    order = [("epe", CLEAN), *((metric, AVERAGE) for metric in RESULT_METRICS)]
    rows = frame.filter(pl.col("severity").is_null()).to_dicts()
    known = {(row["measure"], row["condition"]): row for row in rows}
    return [known[key] for key in order if key in known]


def _caveats(run: Run, means: Sequence[dict[str, Any]]) -> str:
    """Return what a reader needs to know before comparing the numbers."""
    setting, out = run.setting, []
    if run.setting not in ("OOD", "knowledge"):
        explained = SETTING_EXPLANATIONS.get(setting, "see the manifest")
        out.append(f"{SETTING_LABELS.get(setting, setting)}: {explained}.")
    if note := comparison_note(run):
        out.append(f"This is {note}.")
    if reasons := exclusion_reasons(run):
        out.append(f"Not ranked, because {' and '.join(reasons)}.")
    if not run.measured.complete:
        out.append("The run is incomplete: some rows are missing or have no valid pixels.")
    if run.averages.has_gaps:
        share = 100 * (run.mean("coverage") or 0)
        out.append(f"The model predicted {share:.1f} % of the pixels; errors are computed over these pixels.")
    if means and all(mean["low"] is None for mean in means):
        out.append(f"No intervals: too few pairs for a bootstrap ({run.measured.samples}), or one decides the means.")
    return " ".join(plain(each, None) for each in out)


def _day(run: Run) -> str:
    """Return the day on which the run finished, in UTC; "" if its manifest does not contain it."""
    try:
        return datetime.fromisoformat(run.manifest.finished or "").astimezone(UTC).date().isoformat()
    except (ValueError, OverflowError):
        return ""


def _huggingface_files(run: Run, dataset: str) -> Files:
    """Return `.eval_results/robustflow.yaml` with the clean and average means. JSON strings are valid YAML."""
    means = _means(run)
    about = f"Run {run.manifest.identity_digest} of {plain(run.name)}. {_caveats(run, means)}".strip()
    text = ""
    for mean in means:
        interval = "" if mean["low"] is None else f"95 % interval {mean['low']:.4g} to {mean['high']:.4g}. "
        task = mean["measure"] + ("_clean" if mean["condition"] == CLEAN else "")
        lines = [
            "- dataset:",
            f"    id: {json.dumps(dataset)}",
            f"    task_id: {task}",
            f"  value: {mean['value']!r}",
            *([f"  date: {json.dumps(_day(run))}"] if _day(run) else []),
            "  evaluation_framework: robustflow",
            f"  notes: {json.dumps(interval + about)}",
        ]
        text += "\n".join(lines) + "\n"
    return {PurePosixPath(".eval_results", "robustflow.yaml"): text.encode()}


_ROWS = "rows.csv"
_TYPES: dict[Any, str] = {pl.String: "sc:Text", pl.Int64: "sc:Integer", pl.Float64: "sc:Float"}
_SHORT = ("citeAs", "column", "conformsTo", "extract", "field", "fileObject", "recordSet", "source")
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "sc": "https://schema.org/",
    "dct": "http://purl.org/dc/terms/",
    **{name: f"cr:{name}" for name in _SHORT},
    "conformsTo": "dct:conformsTo",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
}


def _croissant_files(run: Run) -> Files:
    """Return `croissant.json` and the file that it describes, `rows.csv`."""
    rows, name = rows_to_text(run.rows), plain(run.name)
    title = plain(benchmark_facts(run.benchmark).title)
    version = plain(run.manifest.environment.packages.get("robustflow", "unknown"))
    metadata = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": file_name(f"robustflow {name} {title}"),
        "description": (
            f"Errors of the optical flow of {name} on {title}, clean and corrupted: sums and counts, one row per pair, "
            f"corruption and severity, measured by RobustFlow {version} (run {run.manifest.identity_digest}). "
            + _caveats(run, _means(run))
        ).strip(),
        "version": "1.0.0",
        **({"datePublished": day} if (day := _day(run)) else {}),
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": _ROWS,
                "name": _ROWS,
                "contentUrl": _ROWS,
                "contentSize": f"{len(rows)} B",
                "encodingFormat": "text/csv",
                "sha256": hashlib.sha256(rows).hexdigest(),
            }
        ],
        "recordSet": [{"@type": "cr:RecordSet", "@id": "rows", "name": "rows", "field": [*map(_field, ROW_SCHEMA)]}],
    }
    return {PurePosixPath("croissant.json"): json_bytes(metadata), PurePosixPath(_ROWS): rows}


def _field(column: str) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"rows/{column}",
        "name": column,
        "dataType": _TYPES[ROW_SCHEMA[column]],
        "source": {"fileObject": {"@id": _ROWS}, "extract": {"column": column}},
    }


_LARGEST = 2**29
_HUB_DATASET = re.compile(f'^    id: "({HUB_NAME})"$'.encode(), re.MULTILINE)


def check_exported(reader: Reader, paths: Sequence[Path]) -> str:
    """Check that each file matches an export of the record, byte for byte; return a sentence with the number of
    files.
    """
    run = reader.open(Run)
    for path in paths:
        _check(path, run)
    return counted(len(paths), "file")


def _check(path: Path, run: Run) -> None:
    data = read_bounded(path, _LARGEST, "give a file written by 'robustflow export'")
    found = _HUB_DATASET.search(data)
    dataset = found[1].decode() if found else None
    made = [
        each
        for format in EXCHANGE_FORMATS
        if format != "huggingface" or dataset is not None
        for each in exchange_files(run, format, dataset).values()
    ]
    if data in made:
        return
    given = data.split(b"\n")
    nearest = max((each.split(b"\n") for each in made), key=lambda lines: sum(map(eq, lines, given)))
    number = next((n for n, same in enumerate(map(eq, nearest, given), 1) if not same), None)
    if number is None:
        raise RunError(path, f"{len(given)} lines, but an export of the record has {len(nearest)}; export it again")
    written, expected = (plain(lines[number - 1].decode(errors="replace"), 80) for lines in (given, nearest))
    raise RunError(path, f"line {number}: '{written}', but an export of the record has '{expected}'; export it again")
