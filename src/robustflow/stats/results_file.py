"""Read and write results as a CSV file with one value per line, for the published tables and for users' own results.

    benchmark, setting, model, metric, corruption, value, marked, source, sample_set, note, coverage

`corruption` is a corruption's name, "clean", or "average"; `metric` is "epe", "cre" or "rcre" (pixels) or "crer" (no
unit). Text in the file is untrusted and is never interpreted.
"""

from __future__ import annotations

import csv
import io
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import DataError, UsageError
from ..core.files import read_bounded
from ..core.paths import user_path
from ..core.text import text_cell
from ..corruptions.condition import condition_of
from ..corruptions.registry import MEMBERS, ON_DISK
from ..metrics.measures import MEASURES
from .frame import given_frame, line_by_line, of_results
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


def read_results(path: str | Path) -> pl.DataFrame:
    """Read a results file as a results frame: CSV, UTF-8, with a header."""
    path = user_path(path)
    data = read_bounded(path, _LARGEST_FILE, "give a CSV file of results")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(path, "not UTF-8 text; give a CSV file of results") from error
    return parse_results(text, str(path), FILE)


FILE = "file"
"""The sample set of lines without a `sample_set`."""


def parse_results(text: str, name: str, sample_set: str, source: str = "claimed") -> pl.DataFrame:
    """Parse the text of a results file, see `read_results`. `name` appears in error messages; `sample_set` is used for
    lines without a sample set."""
    reader = csv.DictReader(io.StringIO(text), strict=True)
    try:
        names = reader.fieldnames or ()
        if absent := [column for column in _REQUIRED if column not in names]:
            raise DataError(name, f"no column '{absent[0]}'; the header must contain {','.join(_REQUIRED)}")
        if duplicates := [column for column in _WRITTEN if names.count(column) > 1]:
            raise DataError(name, f"the column '{duplicates[0]}' appears twice; remove one of the two")
        numbers = [_number_of_line(line, f"{name}, line {reader.line_num}", sample_set) for line in reader]
    except csv.Error as error:
        raise DataError(f"{name}, line {reader.line_num}", f"{error}; this is not a CSV file of results") from error
    return given_frame((number | {"source": source} for number in numbers), name)


def _number_of_line(line: dict[Any, Any], where: str, sample_set: str) -> dict[str, Any]:
    """Parse one line of the file, which contains one value, as a row of the results frame."""
    if None in line or None in line.values():
        raise DataError(where, "the number of cells differs from that of the header; quote cells that contain commas")
    cells = {column: line[column].strip() for column in line}
    for column in ("setting", "model", "metric", "corruption"):
        if not cells[column] or len(cells[column]) > _LONGEST_TEXT:
            raise DataError(where, f"'{column}' must be 1 to {_LONGEST_TEXT} characters long")
    if cells["metric"] not in RESULT_METRICS:
        raise DataError(where, f"unknown metric '{cells['metric'][:40]}'; choose from {', '.join(RESULT_METRICS)}")
    marked = cells.get("marked", "")
    if marked not in _MARKED:
        raise DataError(where, f"'marked' must be yes, no or empty, not '{marked[:40]}'")
    _check_corruption(cells["corruption"], where)
    number, decimals = _number(cells["value"], where)
    if number < MEASURES[cells["metric"]].bounds[0]:
        raise DataError(where, f"{cells['metric'].upper()} {number:g}: a length in pixels cannot be negative")
    return {
        "benchmark": cells.get("benchmark") or "kitti-fc",
        "sample_set": cells.get("sample_set") or sample_set,
        "setting": cells["setting"],
        "model": cells["model"],
        "note": cells.get("note"),
        "measure": cells["metric"],
        "condition": cells["corruption"],
        "value": number,
        "decimals": decimals,
        "marked": _MARKED[marked],
        "origin": cells.get("source"),
        "coverage": _share(cells.get("coverage", ""), where),
    }


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
    if name not in (CLEAN, AVERAGE, *ELSEWHERE) and name not in ON_DISK:
        try:
            condition_of(name).check()
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


_TEXTS = ("benchmark", "setting", "model", "measure", "condition", "origin", "sample_set", "note")
_MARKED = {"": None, "yes": True, "no": False}


def results_csv(frame: pl.DataFrame) -> str:
    """Write the EPE, CRE, RCRE and CREr of a results frame as text that `read_results` can read, each value
    with its known number of decimals. `read_results` reads every value as claimed, whatever its `origin`."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_WRITTEN, "origin"])
    marks = {mark: text for text, mark in _MARKED.items()}
    single = of_results(frame).filter(~pl.col("condition").is_in(list(MEMBERS)))
    for row in line_by_line(single).iter_rows(named=True):
        texts = (row[name] for name in _TEXTS)
        share = "" if row["coverage"] is None else repr(row["coverage"])
        number = _unrounded(row["value"]) if row["decimals"] is None else f"{row['value']:.{row['decimals']}f}"
        writer.writerow([*map(text_cell, (*texts, share)), number, marks[row["marked"]], row["source"]])
    return out.getvalue()


def _unrounded(number: float) -> str:
    """Write a number with enough decimals to be read as unrounded."""
    text = repr(number)
    return text if _number(text, "")[1] is None else f"{number:.{_MOST_PRINTED + 1}f}"
