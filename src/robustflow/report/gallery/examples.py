"""Example pictures of a run: the worst and the median cell as panels, and one sample under every corruption.

A page shows the row with the highest and the row with the median CRE (RCRE if the run has no ground truth). The choice
follows from the rows, so it is the same on every machine. The folder RUN/examples, with the pictures and their list
`examples.json`, is complete or absent.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

import polars as pl
from pydantic import Field

from ...core.types import Untrusted
from ...corruptions.registry import ordered
from ...metrics.cube import averaged_rows
from ...metrics.error_maps import cre as cre_of
from ...metrics.rows import CLEAN, ROW_KEY
from ...run.run import Run

FOLDER, EXAMPLES_FILE = "examples", "examples.json"
_SUMS = ("epe_sum", "clean_epe_sum", "rcre_sum", "n_valid", "rcre_all_sum", "n_all")
_File = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
_Text = Annotated[str, Field(max_length=4096)]


class _ListedPicture(Untrusted):
    corruption: _Text
    severity: Annotated[int, Field(ge=1, le=5)]
    file: _File


class ListedSlider(Untrusted):
    key: _Text
    clean: _File
    pictures: Annotated[list[_ListedPicture], Field(max_length=1000)]


class Panel(_ListedPicture):
    """A cell that is drawn as a panel, with its scores."""

    kind: Literal["worst", "median"]
    key: _Text
    epe: float | None
    cre: float | None
    rcre: float | None


class ExampleList(Untrusted):
    """The content of `examples.json`."""

    version: Literal[1] = 1
    slider: ListedSlider
    panels: Annotated[list[Panel], Field(max_length=8)]

    @property
    def files(self) -> list[str]:
        return [self.slider.clean, *(picture.file for picture in (*self.slider.pictures, *self.panels))]


class CellScores(NamedTuple):
    """The scores of a cell in pixels: only RCRE without ground truth, None if no pixel can be compared."""

    epe: float | None
    cre: float | None
    rcre: float | None


def cell_scores(row: dict[str, Any]) -> CellScores:
    n = row["n_valid"]
    epe, before = _mean(row["epe_sum"], n), _mean(row["clean_epe_sum"], n)
    rcre = _mean(row["rcre_all_sum"], row["n_all"]) if n is None else _mean(row["rcre_sum"], n)
    return CellScores(epe, cre_of(epe, before), rcre)


def _mean(total: float | None, count: int | None) -> float | None:
    return total / count if count and total is not None else None


def example_cells(rows: pl.DataFrame) -> list[Panel]:
    """Return the cell with the highest and the one with the median CRE; empty if nothing was measured."""
    cells = averaged_rows(rows).filter(pl.col("corruption") != CLEAN).select(*ROW_KEY, *_SUMS).sort(ROW_KEY)
    scored = {
        (row["sample"], row["corruption"], row["severity"]): cell_scores(row) for row in cells.iter_rows(named=True)
    }
    metric = "cre" if any(scores.cre is not None for scores in scored.values()) else "rcre"
    order = sorted((value, *cell) for cell, scores in scored.items() if (value := getattr(scores, metric)) is not None)
    if not order:
        return []
    highest = next(cell for value, *cell in order if value == order[-1][0])
    drawn: dict[Literal["worst", "median"], Sequence[Any]] = {
        "worst": highest,
        "median": order[(len(order) - 1) // 2][1:],
    }
    return [
        Panel(kind=kind, file=f"{kind}.jpg", key=key, corruption=name, severity=severity, **scores._asdict())
        for kind, (key, name, severity) in drawn.items()
        for scores in [scored[key, name, severity]]
    ]


def example_list(rows: pl.DataFrame) -> ExampleList | None:
    """Return the content of `examples.json`, computed from the rows; None if nothing was measured."""
    panels = example_cells(rows)
    if not panels:
        return None
    median = panels[1].key
    of_sample = rows.filter((pl.col("sample") == median) & (pl.col("corruption") != CLEAN))
    pictures = []
    for index, name in enumerate(ordered(of_sample["corruption"].unique())):
        # a number for a stack, whose name contains "+" and ":"
        stem = name if re.fullmatch("[a-z0-9_]{1,40}", name) else f"other-{index}"
        for severity in sorted(of_sample.filter(corruption=name)["severity"].unique()):
            pictures.append(_ListedPicture(corruption=name, severity=severity, file=f"{stem}_{severity}.jpg"))
    return ExampleList(slider=ListedSlider(key=median, clean="clean.jpg", pictures=pictures), panels=panels)


def are_current(run: Run) -> bool:
    """Return whether the pictures in a run's folder match its rows."""
    home, listed = run.path / FOLDER, example_list(run.rows)
    try:
        on_disk = ExampleList.model_validate_json((home / EXAMPLES_FILE).read_bytes())
    except (OSError, ValueError):
        return False
    return on_disk == listed and all((home / name).is_file() for name in on_disk.files)
