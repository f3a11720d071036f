"""Choose which cells of a run to draw: the worst cell of the worst sample, and the median cell of the median
sample. Read and write `examples.json`: which example pictures a run's folder contains and what they show.

A sample's score is its CRE over all corruptions of the run; if the run has no ground truth, its RCRE. The scores are
computed from rows, so the choice is the same on every machine.

    RUN/examples/examples.json   the list, with numbers from the run's rows
    RUN/examples/*.jpg           the pictures

The folder RUN/examples is complete or absent.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, Literal, TypeVar

import polars as pl

from ..core.files import TEMPORARY
from ..corruptions.registry import ordered
from ..metrics.error_maps import cre as cre_of
from ..metrics.means import averaged_rows
from ..metrics.rows import CLEAN, ROW_KEY
from .run import Run

Kind = Literal["worst", "median"]

_SUMS = ("epe_sum", "clean_epe_sum", "rcre_sum", "n_valid", "rcre_all_sum", "n_all")

T = TypeVar("T", bound=tuple[Any, ...])


@dataclass(frozen=True)
class CellScores:
    """The scores of one cell, in pixels. EPE and CRE are None without ground truth; RCRE is None if no pixel can be
    compared."""

    epe: float | None
    cre: float | None
    rcre: float | None


@dataclass(frozen=True)
class ExampleCell:
    """A cell to draw, and the reason for drawing it."""

    kind: Kind
    key: str
    corruption: str
    severity: int
    scores: CellScores


def example_cells(rows: pl.DataFrame) -> list[ExampleCell]:
    """Find the worst cell of the worst sample and the median cell of the median sample in a run's rows."""
    cells = (
        averaged_rows(rows)
        .filter(pl.col("corruption") != CLEAN)
        .select(*ROW_KEY, *_SUMS)
        .sort(ROW_KEY)
        .iter_rows(named=True)
    )
    scored = {(row["sample"], row["corruption"], row["severity"]): cell_scores(row) for row in cells}
    metric = "cre" if any(scores.cre is not None for scores in scored.values()) else "rcre"
    values = {cell: getattr(scores, metric) for cell, scores in scored.items() if getattr(scores, metric) is not None}
    if not values:
        return []
    of_sample: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for (key, corruption, _), value in values.items():
        of_sample[key][corruption].append(value)
    # as in the paper: over severities, then over corruptions
    samples = {(key,): fmean(map(fmean, by_corruption.values())) for key, by_corruption in of_sample.items()}
    chosen: list[ExampleCell] = []
    for kind, pick in (("worst", _worst), ("median", _median)):
        (key,) = pick(samples)
        cell = pick({cell: value for cell, value in values.items() if cell[0] == key})
        chosen.append(ExampleCell(kind, *cell, scored[cell]))  # type: ignore[arg-type]  # kind is one of the two
    return chosen


def cell_scores(row: dict[str, Any]) -> CellScores:
    """Compute EPE, CRE and RCRE of one row."""
    n = row["n_valid"]
    epe, before = _mean(row["epe_sum"], n), _mean(row["clean_epe_sum"], n)
    rcre = _mean(row["rcre_all_sum"], row["n_all"]) if n is None else _mean(row["rcre_sum"], n)
    return CellScores(epe, cre_of(epe, before), rcre)


def _mean(total: float | None, count: int | None) -> float | None:
    return total / count if count and total is not None else None


def _worst(values: dict[T, float]) -> T:
    return min(values, key=lambda name: (-values[name], name))


def _median(values: dict[T, float]) -> T:
    order = sorted(values, key=lambda name: (values[name], name))
    return order[(len(order) - 1) // 2]


FOLDER, EXAMPLES_FILE, VERSION = "examples", "examples.json", 1

SLIDER_WIDTH = 384
"""Maximum width of a slider picture in pixels, in the folder and on pages."""


def example_list(rows: pl.DataFrame) -> dict[str, Any] | None:
    """Return the content of `examples.json`, computed from the rows; None if nothing was measured."""
    cells = example_cells(rows)
    if not cells:
        return None
    panels = [
        {
            "kind": cell.kind,
            "key": cell.key,
            "corruption": cell.corruption,
            "severity": cell.severity,
            **asdict(cell.scores),
            "file": f"{cell.kind}.jpg",
        }
        for cell in cells
    ]
    median = next(cell.key for cell in cells if cell.kind == "median")
    of_sample = rows.filter((pl.col("sample") == median) & (pl.col("corruption") != CLEAN))
    names = ordered(of_sample["corruption"].unique())
    conditions = sorted(
        of_sample.select("corruption", "severity").iter_rows(), key=lambda cell: (names.index(cell[0]), cell[1])
    )
    pictures = [
        {"corruption": name, "severity": severity, "file": f"{_plain_name(name, names.index(name))}_{severity}.jpg"}
        for name, severity in conditions
    ]
    return {
        "version": VERSION,
        "slider": {"key": median, "clean": "clean.jpg", "pictures": pictures},
        "panels": panels,
    }


def _plain_name(corruption: str, index: int) -> str:
    """Return a file name for a corruption: its name, or a number for a stack, whose name contains "+" and ":"."""
    return corruption if re.fullmatch("[a-z0-9_]{1,40}", corruption) else f"other-{index}"


def are_current(result: Run) -> bool:
    """Return whether the pictures in a run's folder match its rows."""
    listed = example_list(result.rows)
    home = result.path / FOLDER
    try:
        on_disk = json.loads((home / EXAMPLES_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    if listed is None or on_disk != listed:
        return False
    slider = listed["slider"]
    names = [slider["clean"], *(picture["file"] for picture in (*slider["pictures"], *listed["panels"]))]
    return all((home / name).is_file() for name in names)


def drop_examples(run: Path) -> None:
    """Remove a run's outdated example pictures."""
    home = run / FOLDER
    if home.is_dir():
        old = home.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-old")  # readers must never see an incomplete folder
        home.rename(old)
        shutil.rmtree(old, ignore_errors=True)
