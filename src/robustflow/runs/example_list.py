"""Read and write `examples.json`: which example pictures a run's folder contains and what they show.

    RUN/examples/examples.json   the list, with numbers from the run's rows
    RUN/examples/*.jpg           the pictures

The folder RUN/examples is complete or absent.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import polars as pl

from ..atomic import TEMPORARY
from ..corruptions.names import ordered
from ..metrics.rows import CLEAN
from .example_cells import example_cells
from .run import Run

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
