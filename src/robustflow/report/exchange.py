"""Export a run's means as Hugging Face evaluation results (`.eval_results/*.yaml` in a model's repository, shown by the
Hub), and compare exported files with a run.

Exports are deterministic, so `check_exported` can compare a file with the run's record byte for byte.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from operator import eq
from pathlib import Path, PurePosixPath
from typing import Any

import polars as pl

from ..core.errors import RunError, UsageError
from ..core.files import read_bounded
from ..core.text import counted, plain
from ..run.records.format import rows_to_text
from ..run.records.read import Reader
from ..run.run import Run
from ..stats.exclusion import exclusion_reasons
from ..stats.frame import results_frame
from ..stats.notes import comparison_note
from ..stats.results import AVERAGE, CLEAN, RESULT_METRICS, SETTING_EXPLANATIONS, SETTING_LABELS

HUB_FILE = PurePosixPath(".eval_results", "robustflow.yaml")
"""Path of the results in a model's repository on the Hub."""
HUB_NAME = r"[A-Za-z0-9_.-]{1,96}/[A-Za-z0-9_.-]{1,96}"


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
        out.append(f"No intervals: too few independent pairs ({run.measured.samples} pairs).")
    return " ".join(plain(each, None) for each in out)


def _day(run: Run) -> str:
    """Return the day on which the run finished, in UTC; "" if its manifest does not contain it."""
    try:
        return datetime.fromisoformat(run.manifest.finished or "").astimezone(UTC).date().isoformat()
    except (ValueError, OverflowError):
        return ""


def hub_results(run: Run, dataset: str | None) -> bytes:
    """Return the content of `HUB_FILE`: the clean and average means of a run on a dataset of the Hub."""
    if dataset is None or not re.fullmatch(HUB_NAME, dataset):
        raise UsageError(
            "--hub-dataset", "--format huggingface needs the benchmark's dataset on the Hub, ORGANISATION/NAME"
        )
    means = _means(run)
    about = f"Run {run.manifest.identity_digest} of {plain(run.name)}. {_caveats(run, means)}".strip()
    text = ""  # JSON strings are valid YAML
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
    return text.encode()


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
    hub = _HUB_DATASET.search(data)
    made = [rows_to_text(run.rows), *([hub_results(run, hub[1].decode())] if hub else [])]
    if data in made:
        return
    given = data.split(b"\n")
    nearest = max((export.split(b"\n") for export in made), key=lambda lines: sum(map(eq, lines, given)))
    number = next((n for n, same in enumerate(map(eq, nearest, given), 1) if not same), None)
    if number is None:
        raise RunError(path, f"{len(given)} lines, but an export of the record has {len(nearest)}; export it again")
    written, expected = (plain(lines[number - 1].decode(errors="replace"), 80) for lines in (given, nearest))
    raise RunError(path, f"line {number}: '{written}', but an export of the record has '{expected}'; export it again")
