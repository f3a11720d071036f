"""Choose which cells of a run to draw, and keep the pictures of the severity slider while a run corrupts frames.

A page shows the worst sample under the worst condition, which is the corruption and severity with the highest mean CRE
(RCRE if the run has no ground truth), and the median cell of the sample whose mean is the median. The choice follows
from the rows, so it is the same on every machine. The folder RUN/examples, with the pictures and their list
`examples.json`, is complete or absent.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple, TypeVar

import numpy as np
import polars as pl

from ..core.errors import DataError
from ..core.files import TEMPORARY, digest_of_bytes, write_bytes
from ..core.types import Frame
from ..corruptions.registry import ordered
from ..media.images import jpeg_bytes, shrunk
from ..metrics.error_maps import cre as cre_of
from ..metrics.means import averaged_rows
from ..metrics.rows import CLEAN, ROW_KEY
from .run import Run

FOLDER, EXAMPLES_FILE, VERSION = "examples", "examples.json", 1
SLIDER_WIDTH = 384
"""Maximum width of a slider picture in pixels, in the folder and on pages."""
_SUMS = ("epe_sum", "clean_epe_sum", "rcre_sum", "n_valid", "rcre_all_sum", "n_all")

T = TypeVar("T", bound=tuple[Any, ...])


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


def example_cells(rows: pl.DataFrame) -> list[dict[str, Any]]:
    """Return the worst cell of the worst condition and the median cell of the median sample, with their scores, as in
    `examples.json`; empty if nothing was measured."""
    cells = averaged_rows(rows).filter(pl.col("corruption") != CLEAN).select(*ROW_KEY, *_SUMS).sort(ROW_KEY)
    scored = {
        (row["sample"], row["corruption"], row["severity"]): cell_scores(row) for row in cells.iter_rows(named=True)
    }
    metric = "cre" if any(scores.cre is not None for scores in scored.values()) else "rcre"
    values = {cell: getattr(scores, metric) for cell, scores in scored.items() if getattr(scores, metric) is not None}
    if not values:
        return []
    of_condition: dict[tuple[str, int], list[float]] = defaultdict(list)
    of_sample: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for (key, *condition), value in values.items():
        of_condition[tuple(condition)].append(value)
        of_sample[key][condition[0]].append(value)
    worst = _worst({condition: fmean(each) for condition, each in of_condition.items()})
    # as in the paper: over severities, then over corruptions
    (median,) = _median({(key,): fmean(map(fmean, of_key.values())) for key, of_key in of_sample.items()})
    drawn = {
        "worst": _worst({cell: value for cell, value in values.items() if cell[1:] == worst}),
        "median": _median({cell: value for cell, value in values.items() if cell[0] == median}),
    }
    chosen = []
    for kind, cell in drawn.items():
        place = dict(zip(("key", "corruption", "severity"), cell, strict=True))
        chosen.append({"kind": kind, **place, **scored[cell]._asdict(), "file": f"{kind}.jpg"})
    return chosen


def _worst(values: dict[T, float]) -> T:
    return min(values, key=lambda name: (-values[name], name))


def _median(values: dict[T, float]) -> T:
    order = sorted(values, key=lambda name: (values[name], name))
    return order[(len(order) - 1) // 2]


def example_list(rows: pl.DataFrame) -> dict[str, Any] | None:
    """Return the content of `examples.json`, computed from the rows; None if nothing was measured."""
    panels = example_cells(rows)
    if not panels:
        return None
    median = panels[1]["key"]
    of_sample = rows.filter((pl.col("sample") == median) & (pl.col("corruption") != CLEAN))
    names = ordered(of_sample["corruption"].unique())
    pictures = [
        {"corruption": name, "severity": severity, "file": f"{_file_name(name, index)}_{severity}.jpg"}
        for index, name in enumerate(names)
        for severity in sorted(of_sample.filter(corruption=name)["severity"].unique())
    ]
    slider = {"key": median, "clean": "clean.jpg", "pictures": pictures}
    return {"version": VERSION, "slider": slider, "panels": panels}


def _file_name(corruption: str, index: int) -> str:
    """Return a corruption's name, or a number for a stack, whose name contains "+" and ":"."""
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
    home = run / FOLDER
    if home.is_dir():
        old = home.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-old")  # readers must never see an incomplete folder
        home.rename(old)
        shutil.rmtree(old, ignore_errors=True)


def slider_picture(frames: tuple[Frame, ...], clean: tuple[Frame, ...]) -> bytes:
    """Return a JPEG of the first frame that a corruption changed: over_exposure changes only one of the two."""
    changed = [frame for frame, before in zip(frames, clean, strict=False) if not np.array_equal(frame, before)]
    return jpeg_bytes(shrunk((changed or frames)[0], SLIDER_WIDTH))


def keep_picture(
    folder: Path, frames: tuple[Frame, ...], clean: tuple[Frame, ...], corruption: str, severity: int
) -> None:
    """Store the picture of a cell. A picture that cannot be written is generated later."""
    with suppress(DataError):
        write_bytes(_picture_path(folder, corruption, severity), slider_picture(frames, clean), durable=False)


def stored_picture(folder: Path | None, corruption: str, severity: int) -> bytes | None:
    """Return the picture stored by `keep_picture`, or None."""
    try:
        return None if folder is None else _picture_path(folder, corruption, severity).read_bytes()
    except OSError:
        return None


def _picture_path(folder: Path, corruption: str, severity: int) -> Path:
    return folder / f"{digest_of_bytes(f'{corruption} {severity}'.encode(), size=16)}.jpg"
