"""Example pictures of a run: the worst and the median cell as panels, and one sample under every corruption.

A page shows the row with the highest and the row with the median CRE (RCRE if the run has no ground truth). The choice
follows from the rows, so it is the same on every machine. The folder RUN/examples, with the pictures and their list
`examples.json`, is complete or absent.
"""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal, NamedTuple

import polars as pl
from pydantic import Field

from ...core.errors import DataError, RunError, unknown_name
from ...core.files import TEMPORARY, make_folder, write_bytes, write_json
from ...core.processes import in_child
from ...core.types import Untrusted
from ...corruptions.registry import ordered
from ...media.images import jpeg_bytes, shrunk
from ...metrics.cube import averaged_rows
from ...metrics.error_maps import cre as cre_of
from ...metrics.rows import CLEAN, ROW_KEY
from ...models.base import describe_cell
from ...run.cells import Cell
from ...run.engines.choose import suits_a_child
from ...run.pictures import SLIDER_WIDTH, picture_path, slider_picture
from ...run.plan import Job, Plan
from ...run.run import Run
from ...run.worker import View, Worker, temporary_worker
from .panel import draw_panel, numbers_line, panel_title

FOLDER, EXAMPLES_FILE = "examples", "examples.json"
_SUMS = ("epe_sum", "clean_epe_sum", "rcre_sum", "n_valid", "rcre_all_sum", "n_all")
_SAME_PX, _SAME_SHARE = 0.01, 0.01
"""Tolerances for a repeated prediction: rounding depends on the batch size and the device."""

_File = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
_Text = Annotated[str, Field(max_length=4096)]


class _ListedPicture(Untrusted):
    corruption: _Text
    severity: Annotated[int, Field(ge=1, le=5)]
    file: _File


class _ListedSlider(Untrusted):
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
    slider: _ListedSlider
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
    return ExampleList(slider=_ListedSlider(key=median, clean="clean.jpg", pictures=pictures), panels=panels)


def are_current(run: Run) -> bool:
    """Return whether the pictures in a run's folder match its rows."""
    home, listed = run.path / FOLDER, example_list(run.rows)
    try:
        on_disk = ExampleList.model_validate_json((home / EXAMPLES_FILE).read_bytes())
    except (OSError, ValueError):
        return False
    return on_disk == listed and all((home / name).is_file() for name in on_disk.files)


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
        given = (making, plan.job(folder=plan.pictures and run.path), listed, rows)
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


def _write_slider(folder: Path, slider: _ListedSlider, worker: Worker, pictures: Path | None) -> None:
    clean = worker.sample(slider.key).frames
    write_bytes(folder / slider.clean, jpeg_bytes(shrunk(clean[0], SLIDER_WIDTH)))
    for one in slider.pictures:
        stored = None if pictures is None else picture_path(pictures, one.corruption, one.severity)
        if stored is not None and stored.is_file():
            stored.replace(folder / one.file)
        else:
            frames = worker.frames(slider.key, one.corruption, one.severity)
            write_bytes(folder / one.file, slider_picture(frames, clean), durable=False)


def _panel(row: dict[str, Any], worker: Worker, why: str, form: str) -> bytes:
    cell, scores = (row["sample"], row["corruption"], row["severity"]), cell_scores(row)
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
    for name, before, now in (("EPE", scores.epe, again.epe), ("RCRE", scores.rcre, again.rcre)):
        if before != now and (before is None or now is None or abs(now - before) > max(_SAME_PX, _SAME_SHARE * before)):
            raise RunError(
                where,
                f"the model predicts a different flow than in the run ({name} {now} instead of {before}), so "
                "an image would not show the measured flow; repeat the run in a different folder",
            )
