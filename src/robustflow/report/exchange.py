"""Facts about a run, shared by both formats: means with intervals, and warnings. Hugging Face evaluation results:
`.eval_results/*.yaml` in a model's repository, which the Hub shows on its page. Croissant metadata: the rows of
a run as a dataset for search engines and loaders. Export a run as Croissant metadata or as Hugging Face
evaluation results. Compare exported files with a record.

Exports are deterministic, so `check_exported` can compare a file with the run's record byte for byte.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import polars as pl

from ..core.errors import RunError, UsageError, unknown_name
from ..core.files import json_bytes, read_bounded
from ..core.text import counted, file_name, plain
from ..data.benchmarks import benchmark_facts
from ..metrics.rows import ROW_SCHEMA
from ..run.records.contents import rows_to_text
from ..run.records.read import Reader
from ..run.run import Run
from ..stats.exclusion import exclusion_reasons
from ..stats.results import AVERAGE, CLEAN, SETTING_EXPLANATIONS, SETTING_LABELS
from ..stats.run_results import comparison_note, run_results, run_setting


@dataclass(frozen=True)
class RunMean:
    """A mean value of a run."""

    metric: str
    condition: str
    value: float
    interval: tuple[float, float] | None


class RunFacts:
    """Description of a run for the export formats. Names are safe to print, but not escaped for any format."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.name = plain(run.name)
        self.title = plain(benchmark_facts(run.benchmark).title)
        self.digest = run.manifest.identity_digest

    @cached_property
    def means(self) -> list[RunMean]:
        """The clean and average means."""
        (line,) = run_results([self.run])
        return [
            RunMean(*key, value.number, line.intervals.get(key))
            for key, value in line.values.items()
            if key[1] in (CLEAN, AVERAGE)
        ]

    @cached_property
    def warnings(self) -> list[str]:
        """Caveats that a reader needs to know before comparing the numbers."""
        run, out = self.run, []
        if run.setting not in ("OOD", "knowledge"):
            setting = run_setting(run)
            out.append(
                f"{SETTING_LABELS.get(setting, setting)}: {SETTING_EXPLANATIONS.get(setting, 'see the manifest')}."
            )
        if note := comparison_note(run):
            out.append(f"This is {note}.")
        if reasons := exclusion_reasons(run):
            out.append(f"Not ranked, because {' and '.join(reasons)}.")
        if not run.measured.complete:
            out.append("The run is incomplete: some rows are missing or have no valid pixels.")
        if run.averages.has_gaps:
            out.append(
                f"The model predicted {100 * (run.mean('coverage') or 0):.1f} % of the pixels; errors are computed "
                "over these pixels."
            )
        if self.means and not any(mean.interval for mean in self.means):
            out.append(
                f"No intervals: too few pairs for a bootstrap ({run.measured.samples}), or one decides the means."
            )
        return [plain(each, None) for each in out]

    @property
    def finished(self) -> datetime | None:
        """Return the time at which the run finished, in UTC; None if its manifest does not contain it."""
        try:
            return datetime.fromisoformat(self.run.manifest.finished or "").astimezone(UTC)
        except (ValueError, OverflowError):
            return None

    @property
    def version(self) -> str:
        """Return the RobustFlow version of the run."""
        return plain(self.run.manifest.environment.packages.get("robustflow", "unknown"))


def huggingface_files(facts: RunFacts, dataset: str) -> dict[PurePosixPath, bytes]:
    """Return `.eval_results/robustflow.yaml` with the clean and average means."""
    text = "".join(_entry(facts, mean, dataset) for mean in facts.means)
    return {PurePosixPath(".eval_results", "robustflow.yaml"): text.encode()}


def _entry(facts: RunFacts, mean: RunMean, dataset: str) -> str:
    interval = "" if mean.interval is None else f"95 % interval {mean.interval[0]:.4g} to {mean.interval[1]:.4g}. "
    lines = [
        "- dataset:",
        f"    id: {_quoted(dataset)}",
        f"    task_id: {mean.metric}{'_clean' if mean.condition == 'clean' else ''}",
        f"  value: {mean.value!r}",
        *([f"  date: {_quoted(facts.finished.date().isoformat())}"] if facts.finished else []),
        "  evaluation_framework: robustflow",
        f"  notes: {_quoted(f'{interval}Run {facts.digest} of {facts.name}. ' + ' '.join(facts.warnings))}",
    ]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """Quote text for YAML."""
    return json.dumps(text.strip())


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


def croissant_files(facts: RunFacts) -> dict[PurePosixPath, bytes]:
    """Return `croissant.json` and the file that it describes, `rows.csv`."""
    rows = rows_to_text(facts.run.rows)
    metadata = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": file_name(f"robustflow {facts.name} {facts.title}"),
        "description": (
            f"Errors of the optical flow of {facts.name} on {facts.title}, clean and corrupted: sums and counts, one "
            f"row per pair, corruption and severity, measured by RobustFlow {facts.version} (run {facts.digest}). "
            + " ".join(facts.warnings)
        ).strip(),
        "version": "1.0.0",
        **({"datePublished": facts.finished.date().isoformat()} if facts.finished else {}),
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


Files = dict[PurePosixPath, bytes]

EXCHANGE_FORMATS = ("croissant", "huggingface")

HUB_NAME = r"[A-Za-z0-9_.-]{1,96}/[A-Za-z0-9_.-]{1,96}"


def exchange_files(run: Run, format: str, hub_dataset: str | None = None) -> Files:
    """Export a run in one of the formats; return file contents by relative path."""
    if format not in EXCHANGE_FORMATS:
        raise unknown_name("exchange format", format, EXCHANGE_FORMATS)
    facts = RunFacts(run)
    if format == "croissant":
        return croissant_files(facts)
    if hub_dataset is None or not re.fullmatch(HUB_NAME, hub_dataset):
        raise UsageError(
            "--format huggingface needs the benchmark's dataset on the Hub: give --hub-dataset ORGANISATION/NAME"
        )
    return huggingface_files(facts, hub_dataset)


_LARGEST = 2**29
_HUB_DATASET = re.compile(f'^    id: "({HUB_NAME})"$'.encode(), re.MULTILINE)


def check_exported(reader: Reader, paths: Sequence[Path]) -> str:
    """Check that each file matches an export of the record, byte for byte; return a sentence with the number of
    files.
    """
    with TemporaryDirectory(prefix="robustflow-") as folder:
        reader.extract(Path(folder))
        run = Run(folder)
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
    nearest = max((each.split(b"\n") for each in made), key=lambda lines: _equal_lines(lines, given))
    number = next((n for n, pair in enumerate(zip(nearest, given, strict=False)) if pair[0] != pair[1]), None)
    if number is None:
        raise RunError(
            f"{path} has {len(given)} lines, but an export of the record has {len(nearest)}: export it again"
        )
    written, expected = (plain(lines[number].decode(errors="replace"), 80) for lines in (given, nearest))
    raise RunError(
        f"{path}, line {number + 1}: '{written}', but an export of the record has '{expected}': export it again"
    )


def _equal_lines(lines: Sequence[bytes], given: Sequence[bytes]) -> int:
    return sum(one == other for one, other in zip(lines, given, strict=False))
