"""Results in one tidy shape, whoever measured them: one value per line, with its source.

    benchmark, setting, model, metric, corruption, value, marked, source

is the shape of the published tables that ship with the package, of a user's own results file, and of results made from
runs. `corruption` is a corruption's name, "clean", or "average"; `metric` is "epe", "cre" or "rcre" (pixels) or "crer"
(no unit). Text in it is untrusted and stays text.
"""

from __future__ import annotations

import csv
import io
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import polars as pl

from ..corruptions.on_disk import on_disk
from ..corruptions.stack import parse_stack
from ..errors import DataError, UsageError
from ..metrics.rows import CLEAN
from ..text import text_cell

AVERAGE = "average"
RESULT_METRICS = ("epe", "cre", "rcre", "crer")
SETTINGS = ("knowledge", "OOD", "ID")
"""The paper's settings: knowledge-driven methods; models not trained on the benchmark's domain; models trained on
it."""

RESULT_SCHEMA: dict[str, Any] = {
    "benchmark": pl.String,
    "setting": pl.String,
    "model": pl.String,
    "metric": pl.String,
    "corruption": pl.String,
    "value": pl.Float64,
    "decimals": pl.Int64,
    "marked": pl.Boolean,
    "source": pl.String,
    "sample_set": pl.String,
    "note": pl.String,
}
"""Columns of a results frame.

`decimals`: digits after the point as printed, null for a number that was not rounded. `marked`: set in bold as the best
of its column, null if the source marks nothing. `sample_set`: results with the same value can be compared. `note`: what
a reader must know before comparing, "" for nothing.
"""

ELSEWHERE = ("brightness", "motion_blur", "rain", "speckle_noise", "zoom_blur")
"""Corruptions that other benchmarks have and this project has not: results may be of them."""

RESULT_KEY = ("sample_set", "benchmark", "setting", "model", "metric", "corruption")
_WRITTEN = ("benchmark", "setting", "model", "metric", "corruption", "source", "sample_set", "note")
_REQUIRED = ("setting", "model", "metric", "corruption", "value")
_LARGEST_FILE = 64 * 2**20
_LONGEST_TEXT = 500
_MOST_PRINTED = 6
"""Digits after the point; a number with more was not rounded for a reader."""


def read_results(path: str | Path) -> pl.DataFrame:
    """A results file in the tidy shape: CSV, UTF-8, with a header.

    Columns `setting`, `model`, `metric`, `corruption` and `value` are needed; `benchmark` ("kitti-fc" by default),
    `marked` ("yes" or "no"), `source`, `sample_set` and `note` are optional; others are ignored.

    Returns:
        Columns of `RESULT_SCHEMA`; `decimals` is counted from the text of each value, and null for more than six: a
        number that a program wrote in full.

    Raises:
        DataError: no such file, not CSV in this shape, an unknown corruption, a value that is not a number or is
            given twice.

    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "mine.csv"
    >>> _ = path.write_text("setting,model,metric,corruption,value\\nOOD,Mine,epe,clean,4.20\\n")
    >>> read_results(path).select("benchmark", "value", "decimals").row(0)
    ('kitti-fc', 4.2, 2)
    """
    path = Path(path).expanduser()
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise DataError(f"{path}: larger than {_LARGEST_FILE >> 20} MiB; results are one short line per value")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise DataError(f"{path}: cannot be read ({reason}); give a CSV file of results") from error
    return parse_results(text, str(path), "file")


def parse_results(text: str, name: str, sample_set: str) -> pl.DataFrame:
    """The text of a results file; see `read_results`. `name` is for messages, `sample_set` for lines without one."""
    reader = csv.DictReader(io.StringIO(text), strict=True)
    records = []
    try:
        absent = [column for column in _REQUIRED if column not in (reader.fieldnames or [])]
        if absent:
            raise DataError(f"{name}: no column '{absent[0]}'; the first line must name {','.join(_REQUIRED)}")
        for line in reader:
            records.append(_record(line, f"{name}, line {reader.line_num}", sample_set))
    except csv.Error as error:
        raise DataError(f"{name}, line {reader.line_num}: {error}; this is not a CSV file of results") from error
    frame = pl.DataFrame(records, schema=RESULT_SCHEMA, orient="row")
    twice = frame.filter(frame.select(RESULT_KEY).is_duplicated())
    if twice.height:
        entry = twice.row(0, named=True)
        raise DataError(
            f"{name}: {entry['metric']} of '{entry['model']}' ({entry['setting']}) on {entry['corruption']} "
            "appears twice; give each value once"
        )
    return frame


def _record(line: dict[Any, Any], where: str, sample_set: str) -> tuple[Any, ...]:
    if None in line or None in line.values():
        raise DataError(
            f"{where}: the number of cells differs from that of the header; quote a cell that contains a comma"
        )
    cells = {column: line[column].strip() for column in line}
    for column in ("setting", "model", "metric", "corruption"):
        if not cells[column] or len(cells[column]) > _LONGEST_TEXT:
            raise DataError(f"{where}: '{column}' must be 1 to {_LONGEST_TEXT} characters long")
    if cells["metric"] not in RESULT_METRICS:
        raise DataError(f"{where}: unknown metric '{cells['metric'][:40]}'; choose from {', '.join(RESULT_METRICS)}")
    marked = cells.get("marked", "")
    if marked not in ("", "yes", "no"):
        raise DataError(f"{where}: 'marked' must be yes, no or empty, not '{marked[:40]}'")
    _check_corruption(cells["corruption"], where)
    value, decimals = _number(cells["value"], where)
    if value < 0 and cells["metric"] in ("epe", "rcre"):
        raise DataError(f"{where}: {cells['metric'].upper()} {value:g}: a length in pixels cannot be below 0")
    return (
        cells.get("benchmark") or "kitti-fc",
        cells["setting"],
        cells["model"],
        cells["metric"],
        cells["corruption"],
        value,
        decimals,
        None if marked == "" else marked == "yes",
        cells.get("source") or "",
        cells.get("sample_set") or sample_set,
        cells.get("note") or "",
    )


def _check_corruption(name: str, where: str) -> None:
    if name not in (CLEAN, AVERAGE, *ELSEWHERE) and on_disk(name) is None:
        try:
            parse_stack(name)
        except UsageError as error:
            raise DataError(f"{where}: {error}") from None


def _number(text: str, where: str) -> tuple[float, int | None]:
    """The value and its decimals as written: "4.20" is exact to half a hundredth, "1.527602461899183" not rounded."""
    try:
        number = Decimal(text)
        value = float(number)
    except (InvalidOperation, ValueError):
        raise DataError(f"{where}: '{text[:40]}' is not a number") from None
    exponent = number.as_tuple().exponent
    if not isinstance(exponent, int) or abs(value) > 1e9:
        raise DataError(f"{where}: '{text[:40]}' is not a finite number of pixels")
    decimals = max(0, -exponent)
    return value, decimals if decimals <= _MOST_PRINTED else None


def results_csv(results: pl.DataFrame) -> str:
    """Results (columns of `RESULT_SCHEMA`) as a file that `read_results` can read, each value with its known digits.

    >>> text = "setting,model,metric,corruption,value\\nOOD,Mine,epe,clean,4.20\\n"
    >>> print(results_csv(parse_results(text, "mine.csv", "mine")).splitlines()[1])
    kitti-fc,OOD,Mine,epe,clean,,mine,,4.20,
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_WRITTEN, "value", "marked"])
    for row in results.iter_rows(named=True):
        value = repr(row["value"]) if row["decimals"] is None else f"{row['value']:.{row['decimals']}f}"
        marked = {None: "", True: "yes", False: "no"}[row["marked"]]
        writer.writerow([*(text_cell(row[name]) for name in _WRITTEN), value, marked])
    return out.getvalue()


def values_of(results: pl.DataFrame, metric: str, **where: str) -> dict[tuple[str, str, str], float]:
    """(setting, model, corruption) -> value of one metric.

    >>> values_of(pl.DataFrame(schema=RESULT_SCHEMA), "epe", benchmark="kitti-fc")
    {}
    """
    chosen = results.filter(pl.col("metric") == metric, **where)
    return {
        (setting, model, corruption): value
        for setting, model, corruption, value in chosen.select("setting", "model", "corruption", "value").iter_rows()
    }
