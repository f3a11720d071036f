"""Write the example pictures of a run with its model, and draw any of its cells."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import polars as pl

from ..core.errors import DataError, RunError, unknown_name
from ..core.files import TEMPORARY, make_folder, write_bytes, write_json
from ..core.processes import in_child
from ..media.images import jpeg_bytes, shrunk
from ..metrics.rows import ROW_KEY
from ..models.calls import describe_cell
from ..report.gallery.examples import (
    EXAMPLES_FILE,
    FOLDER,
    CellScores,
    ExampleList,
    ListedSlider,
    cell_scores,
    example_list,
)
from ..run.engines.choose import suits_a_child
from ..run.manifest import Cell
from ..run.plan import Job, Plan
from ..run.run import Run
from ..run.stages import SLIDER_WIDTH, picture_path, slider_picture
from ..run.worker import View, Worker, temporary_worker
from .panel import draw_panel, numbers_line, panel_title

_SAME_PX, _SAME_SHARE = 0.01, 0.01
"""Tolerances for a repeated prediction: rounding depends on the batch size and the device."""


def drop_examples(run: Path) -> None:
    home = run / FOLDER
    if home.is_dir():
        old = home.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-old")  # readers must never see an incomplete folder
        home.rename(old)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def capture_slider_pictures(plan: Plan, folder: Path) -> Iterator[Plan]:
    """Yield a plan whose workers store the slider's pictures until the block ends, if its sample is known."""
    if len(plan.benchmark.keys) > 1:
        yield plan
        return
    with TemporaryDirectory(prefix=TEMPORARY, dir=folder, ignore_cleanup_errors=True) as pictures:
        yield replace(plan, pictures=Path(pictures))


def write_examples(run: Run, plan: Plan) -> Generator[str, None, None]:
    """Draw the examples of a complete run into its folder; yield each one of `progress.DRAWN` before it is drawn."""
    if run.measured.missing:
        raise RunError(run.path, "not complete, so its worst sample is unknown; run its command again first")
    listed = example_list(run.rows)
    if listed is None:
        raise RunError(run.path, "has no measured pixel, so there is no worst sample")
    home = run.path / FOLDER
    making = home.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-{FOLDER}")
    make_folder(making)
    try:
        rows = [_row(run.rows, (panel.key, panel.corruption, panel.severity)) for panel in listed.panels]
        job = plan.of_corruptions(run.manifest.corruptions).job(folder=plan.pictures and run.path)
        given = (making, job, listed, rows)
        yield from in_child("the example pictures", _draw_files, *given) if suits_a_child(plan) else _draw_files(*given)
        write_json(making / EXAMPLES_FILE, listed.model_dump())
        drop_examples(run.path)
        try:
            making.rename(home)
        except OSError as error:
            raise DataError(home, f"cannot be written ({error.strerror}); choose a folder with free space") from error
    finally:
        shutil.rmtree(making, ignore_errors=True)


def _draw_files(folder: Path, job: Job, listed: ExampleList, rows: list[dict[str, Any]]) -> Iterator[str]:
    with temporary_worker(job) as worker:
        for panel, row in zip(listed.panels, rows, strict=True):
            yield f"{panel.kind} example"
            write_bytes(folder / panel.file, _panel(row, worker, panel.kind, "jpeg"))
        yield "severity slider"
        _write_slider(folder, listed.slider, worker, job.pictures)


def draw_example(run: Run, plan: Plan, key: str, corruption: str, severity: int) -> bytes:
    """Draw any cell of a run as a PNG, with the scores from the run."""
    with temporary_worker(plan.job()) as worker:
        return _panel(_row(run.rows, (key, corruption, severity)), worker, "", "png")


def _write_slider(folder: Path, slider: ListedSlider, worker: Worker, pictures: Path | None) -> None:
    clean = worker.sample(slider.key).frames
    write_bytes(folder / slider.clean, jpeg_bytes(shrunk(clean[0], SLIDER_WIDTH)))
    for picture in slider.pictures:
        stored = None if pictures is None else picture_path(pictures, picture.corruption, picture.severity)
        if stored is not None and stored.is_file():
            stored.replace(folder / picture.file)
        else:
            frames = worker.frames(slider.key, picture.corruption, picture.severity)
            write_bytes(folder / picture.file, slider_picture(frames, clean), durable=False)


def _panel(row: dict[str, Any], worker: Worker, why: str, form: str) -> bytes:
    cell, scores = (row["sample"], row["corruption"], row["severity"]), cell_scores(row)
    view = worker.inspect_cell(*cell)
    _check_same(view, row, scores)
    return draw_panel(view, panel_title(*cell, why), numbers_line(*scores), form)


def _row(rows: pl.DataFrame, cell: Cell) -> dict[str, Any]:
    for column, value in zip(ROW_KEY, cell, strict=True):
        values = rows[column].unique().sort()
        rows = rows.filter(pl.col(column) == value)
        if rows.is_empty():
            raise unknown_name(f"{column} of this run", str(value), map(str, values[:100]))
    return rows.row(0, named=True)


def _check_same(view: View, row: dict[str, Any], scores: CellScores) -> None:
    """Raise unless an image shows the frames and the flow that were measured."""
    where = describe_cell(row["sample"], row["corruption"], row["severity"])
    if view.row["frames_digest"] != row["frames_digest"]:
        raise RunError(where, "the frames differ from those of the run; use the data of the run")
    again = cell_scores(view.row)
    for name, before, now in (("EPE", scores.epe, again.epe), ("RCRE", scores.rcre, again.rcre)):
        if before != now and (before is None or now is None or abs(now - before) > max(_SAME_PX, _SAME_SHARE * before)):
            raise RunError(
                where,
                f"the model predicts a different flow than in the run ({name} {now} instead of {before}), so "
                "an image would not show the measured flow; repeat the run in a different folder",
            )
