"""Read and write results as a CSV file with one value per line, for the published tables and for users' own results.

    benchmark, setting, model, metric, corruption, value, marked, source, sample_set, note, coverage

`corruption` is a corruption's name, "clean", or "average"; `metric` is "epe", "cre" or "rcre" (pixels) or "crer" (no
unit). Text in the file is untrusted and is never interpreted.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

from ..core.errors import DataError, UsageError
from ..core.files import read_bounded
from ..core.paths import user_path
from ..core.text import text_cell
from ..corruptions.registry import on_disk
from ..corruptions.stack import parse_stack
from .model_result import ModelResult, Value, merged
from .results import AVERAGE, CLEAN, RESULT_METRICS

ELSEWHERE = ("brightness", "motion_blur", "rain", "speckle_noise", "zoom_blur")
"""Corruptions of other benchmarks that are not implemented here but are accepted in results files."""

_WRITTEN = (
    *("benchmark", "setting", "model", "metric", "corruption"),
    *("source", "sample_set", "note", "coverage", "value", "marked"),
)
_REQUIRED = ("setting", "model", "metric", "corruption", "value")
_LARGEST_FILE = 64 * 2**20
_LONGEST_TEXT = 500
_MOST_PRINTED = 6
"""Largest number of decimals of a rounded number; a number with more decimals counts as unrounded."""


def read_results(path: str | Path) -> list[ModelResult]:
    """Read the lines of a results file: CSV, UTF-8, with a header."""
    path = user_path(path)
    data = read_bounded(path, _LARGEST_FILE, "give a CSV file of results")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(path, "not UTF-8 text; give a CSV file of results") from error
    return parse_results(text, str(path), FILE)


FILE = "file"
"""The sample set of lines without a `sample_set`."""


def parse_results(text: str, name: str, sample_set: str) -> list[ModelResult]:
    """Parse the text of a results file, see `read_results`. `name` appears in error messages; `sample_set` is used for
    lines without a sample set."""
    reader = csv.DictReader(io.StringIO(text), strict=True)
    try:
        names = reader.fieldnames or ()
        if absent := [column for column in _REQUIRED if column not in names]:
            raise DataError(name, f"no column '{absent[0]}'; the header must contain {','.join(_REQUIRED)}")
        if duplicates := [column for column in _WRITTEN if names.count(column) > 1]:
            raise DataError(name, f"the column '{duplicates[0]}' appears twice; remove one of the two")
        return merged((_result_of_line(line, f"{name}, line {reader.line_num}", sample_set) for line in reader), name)
    except csv.Error as error:
        raise DataError(f"{name}, line {reader.line_num}", f"{error}; this is not a CSV file of results") from error


def _result_of_line(line: dict[Any, Any], where: str, sample_set: str) -> ModelResult:
    """Parse one line of the file, which contains one value."""
    if None in line or None in line.values():
        raise DataError(where, "the number of cells differs from that of the header; quote cells that contain commas")
    cells = {column: line[column].strip() for column in line}
    for column in ("setting", "model", "metric", "corruption"):
        if not cells[column] or len(cells[column]) > _LONGEST_TEXT:
            raise DataError(where, f"'{column}' must be 1 to {_LONGEST_TEXT} characters long")
    if cells["metric"] not in RESULT_METRICS:
        raise DataError(where, f"unknown metric '{cells['metric'][:40]}'; choose from {', '.join(RESULT_METRICS)}")
    marked = cells.get("marked", "")
    if marked not in _MARKED.values():
        raise DataError(where, f"'marked' must be yes, no or empty, not '{marked[:40]}'")
    _check_corruption(cells["corruption"], where)
    number, decimals = _number(cells["value"], where)
    if number < 0 and cells["metric"] in ("epe", "rcre"):
        raise DataError(where, f"{cells['metric'].upper()} {number:g}: a length in pixels cannot be negative")
    value = Value(number, decimals, None if marked == "" else marked == "yes", cells.get("source") or "")
    return ModelResult(
        benchmark=cells.get("benchmark") or "kitti-fc",
        frames=cells.get("sample_set") or sample_set,
        setting=cells["setting"],
        name=cells["model"],
        note=cells.get("note") or "",
        values={(cells["metric"], cells["corruption"]): value},
        stated_coverage=_share(cells.get("coverage", ""), where),
    )


def _share(text: str, where: str) -> float | None:
    """Parse a share of pixels; None for all of them."""
    try:
        share = float(text or 1)
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise DataError(where, f"'coverage' must be a number from 0 to 1, not '{text[:40]}'")
    return share if share < 1 else None


def _check_corruption(name: str, where: str) -> None:
    if name not in (CLEAN, AVERAGE, *ELSEWHERE) and on_disk(name) is None:
        try:
            parse_stack(name)
        except UsageError as error:
            raise DataError(where, f"{error}") from None


def _number(text: str, where: str) -> tuple[float, int | None]:
    """Parse a value and its number of decimals: "4.20" has two, "1.527602461899183" is unrounded (None)."""
    try:
        number = Decimal(text)
        value = float(number)
    except (InvalidOperation, ValueError):
        raise DataError(where, f"'{text[:40]}' is not a number") from None
    exponent = number.as_tuple().exponent
    if not isinstance(exponent, int) or abs(value) > 1e9:
        raise DataError(where, f"'{text[:40]}' is not a finite number of pixels")
    decimals = max(0, -exponent)
    return value, decimals if decimals <= _MOST_PRINTED else None


_MARKED = {None: "", True: "yes", False: "no"}


def results_csv(results: Iterable[ModelResult]) -> str:
    """Write results as text that `read_results` can read, each value with its known number of decimals. The column
    `origin` (`ModelResult.source`) is ignored by `read_results`, which reads every value as claimed.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_WRITTEN, "origin"])
    for line in results:
        share = "" if line.coverage is None else repr(line.coverage)
        for key, value in line.values.items():
            texts = (line.benchmark, line.setting, line.name, *key, value.source, line.frames, line.note, share)
            number = _unrounded(value.number) if value.decimals is None else f"{value.number:.{value.decimals}f}"
            writer.writerow([*map(text_cell, texts), number, _MARKED[value.marked], line.source])
    return out.getvalue()


def _unrounded(number: float) -> str:
    """Write a number with enough decimals to be read as unrounded."""
    text = repr(number)
    return text if _number(text, "")[1] is None else f"{number:.{_MOST_PRINTED + 1}f}"
