"""Draw example images of a run: the worst and the median cell side by side, and one frame under every corruption."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import polars as pl

from ..core.errors import DataError, RunError, unknown_name
from ..core.files import TEMPORARY, make_folder, write_bytes, write_json
from ..media.images import jpeg_bytes, shrunk
from ..metrics.rows import ROW_KEY
from ..models.base import describe_cell
from .cells import Cell
from .example_cells import (
    EXAMPLES_FILE,
    FOLDER,
    SLIDER_WIDTH,
    CellScores,
    are_current,
    cell_scores,
    drop_examples,
    example_list,
    slider_picture,
    stored_picture,
)
from .plan import Plan
from .run import Run
from .store import RunFolder
from .worker import View, Worker, temporary_worker

_SAME_PX, _SAME_SHARE = 0.01, 0.01
"""Tolerances for a repeated prediction: rounding depends on the batch size and the device."""


@contextmanager
def capture_slider_pictures(plan: Plan, folder: Path) -> Iterator[Plan]:
    """Yield a plan whose workers store the slider's pictures until the block ends, if its sample is known. The clean
    flow of the sample is kept as long."""
    if len(plan.benchmark.keys) > 1:
        yield plan
        return
    with TemporaryDirectory(prefix=TEMPORARY, dir=folder, ignore_cleanup_errors=True) as pictures:
        yield replace(plan, pictures=Path(pictures))
        for key in plan.benchmark.keys:
            RunFolder(folder).clean_path(key).unlink(missing_ok=True)


def write_examples(run: Run, plan: Plan, drawing: Callable[[str], None] = lambda what: None) -> bool:
    """Draw the examples of a complete run into its folder, unless they already exist; `drawing` is called with each one
    of `progress.DRAWN` before it is drawn."""
    if run.measured.missing:
        raise RunError(run.path, "not complete, so its worst sample is unknown; run its command again first")
    listed = example_list(run.rows)
    if listed is None:
        raise RunError(run.path, "has no measured pixel, so there is no worst sample")
    if are_current(run):
        return False
    home = run.path / FOLDER
    making = home.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-{FOLDER}")
    make_folder(making)
    try:
        job = plan.job(run=run.manifest.identity_digest, folder=plan.pictures and run.path)
        with temporary_worker(job) as worker:
            for panel in listed["panels"]:
                drawing(f"{panel['kind']} example")
                cell = (panel["key"], panel["corruption"], panel["severity"])
                write_bytes(making / panel["file"], _picture(run.rows, worker, cell, panel["kind"], "jpeg"))
            drawing("severity slider")
            _write_slider(making, listed["slider"], worker, plan.pictures)
        write_json(making / EXAMPLES_FILE, listed)
        drop_examples(run.path)
        try:
            making.rename(home)
        except OSError as error:
            raise DataError(home, f"cannot be written ({error.strerror}); choose a folder with free space") from error
    finally:
        shutil.rmtree(making, ignore_errors=True)
    return True


def draw_example(run: Run, plan: Plan, key: str, corruption: str, severity: int) -> bytes:
    """Draw any cell of a run as a PNG, with the scores from the run."""
    with temporary_worker(plan.job()) as worker:
        return _picture(run.rows, worker, (key, corruption, severity), "", "png")


def _write_slider(folder: Path, slider: dict[str, Any], worker: Worker, pictures: Path | None) -> None:
    key = slider["key"]
    clean = worker.sample(key).frames
    write_bytes(folder / slider["clean"], jpeg_bytes(shrunk(clean[0], SLIDER_WIDTH)))
    for picture in slider["pictures"]:
        corruption, severity = picture["corruption"], picture["severity"]
        shown = stored_picture(pictures, corruption, severity)
        if shown is None:
            shown = slider_picture(worker.frames(key, corruption, severity), clean)
        write_bytes(folder / picture["file"], shown)


def _picture(rows: pl.DataFrame, worker: Worker, cell: Cell, why: str, form: Literal["png", "jpeg"]) -> bytes:
    from .panel import draw_panel, numbers_line, panel_title  # imports matplotlib, which is needed only here

    row = _row(rows, cell)
    scores = cell_scores(row)
    view = worker.inspect_cell(*cell)
    _check_same(view, row, scores)
    return draw_panel(view, panel_title(*cell, why), numbers_line(*scores), form)


def _row(rows: pl.DataFrame, cell: Cell) -> dict[str, Any]:
    for column, value in zip(ROW_KEY, cell, strict=True):
        known = rows[column].unique().sort()
        rows = rows.filter(pl.col(column) == value)
        if rows.is_empty():
            raise unknown_name(f"{column} of this run", str(value), map(str, known[:100]))
    return rows.row(0, named=True)


def _check_same(view: View, row: dict[str, Any], scores: CellScores) -> None:
    """Raise unless an image shows the frames and the flow that were measured."""
    where = describe_cell(row["sample"], row["corruption"], row["severity"])
    if view.row["frames_digest"] != row["frames_digest"]:
        raise RunError(where, "the frames differ from those of the run; use the data of the run")
    again = cell_scores(view.row)
    for name in ("epe", "rcre"):
        before, now = getattr(scores, name), getattr(again, name)
        if before is None and now is None:
            continue
        if before is None or now is None or abs(now - before) > max(_SAME_PX, _SAME_SHARE * before):
            raise RunError(
                where,
                f"the model predicts a different flow than in the run ({name.upper()} {now} instead of {before}), so "
                "an image would not show the measured flow; repeat the run in a different folder",
            )
