"""Content of a page: runs, results files, and the paper's results."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from typing import TYPE_CHECKING

import polars as pl

from ...core.errors import UsageError
from ...core.files import digest_of_bytes
from ...core.text import plain
from ...run.comparable import sample_set
from ...stats.exclusion import exclusion_reasons
from ...stats.intervals import interval_ends
from ...stats.model_result import ModelResult, by_line, lines_of, run_frame
from ...stats.published.tables import PAPER, published_frame
from ...stats.results import benchmark_words
from ...stats.results_file import FILE, results_csv
from ...stats.run_results import comparison_notes
from ...stats.verdict import Verdict
from ..leaderboard import Cells, Setting, board_cells, boards_of, verdicts_of
from ..table import Table

if TYPE_CHECKING:
    from ...run.run import Run


MOST_DETAILED = 24
"""Maximum number of runs for which a page shows pictures and an interval for every corruption. With more runs, only the
averages have intervals."""


@dataclass(frozen=True)
class Content:
    """The content of a page."""

    title: str
    frame: pl.DataFrame
    lines: Sequence[ModelResult]
    pages: Mapping[ModelResult, str]
    group_titles: Mapping[str, str]
    alone: bool

    @property
    def of_one_run(self) -> bool:
        """Whether the page is the report of a single run; the model's page then comes first."""
        return self.alone and sum(line.run is not None for line in self.lines) == 1

    @cached_property
    def boards(self) -> list[Table]:
        """The leaderboards, one per benchmark."""
        return boards_of(self.cells, self.group_titles)

    @cached_property
    def cells(self) -> dict[ModelResult, Cells]:
        """The cells of each line in the leaderboards."""
        return board_cells(self.lines, self.verdicts)

    @cached_property
    def verdicts(self) -> dict[Setting, Verdict]:
        """The verdict on the runs of each setting."""
        return verdicts_of(self.lines)

    @property
    def focus(self) -> list[ModelResult]:
        """The lines that the page is about."""
        return [line for line in self.lines if not (self.alone and line.frames == PAPER)]


def run_content(run: Run) -> Content:
    """Return the content of a run's report: the run first, followed by the paper's lines."""
    title = f"{run.name} on {benchmark_words(run.benchmark)}"
    return _content(plain(title, 160), [run], [], published=True, alone=True)


def whole_content(
    runs: Sequence[Run],
    files: Sequence[tuple[str, pl.DataFrame]] = (),
    *,
    published: bool = True,
) -> Content:
    """Return the content of a leaderboard."""
    return _content("Robustness of optical flow", runs, files, published, alone=False)


def _content(
    title: str, runs: Sequence[Run], files: Sequence[tuple[str, pl.DataFrame]], published: bool, alone: bool
) -> Content:
    # a page about its runs averages over all corruptions of each run, although it also shows the paper's lines
    with_paper, detailed = published and not alone, len(runs) <= MOST_DETAILED
    of_frames: dict[str, list[Run]] = {}
    for run in runs:
        of_frames.setdefault(sample_set(run), []).append(run)
        if not detailed:
            _ = run.averages, exclusion_reasons(run), interval_ends(run, corruptions=False, beside_published=with_paper)
            run.release_rows()
    note_of_run = dict(zip(map(id, runs), comparison_notes(runs, with_paper), strict=True))
    parts: list[pl.DataFrame] = []
    run_of: dict[tuple[str, str], Run] = {}
    titles = {PAPER: "Published values"}
    for frames, group in of_frames.items():
        notes = [note_of_run[id(run)] for run in group]
        titles[frames] = f"Measured: {notes[0] or 'the frames of the paper'}"
        parts.append(run_frame(group, with_paper, notes=notes, detailed=detailed, intervals=True))
        run_of |= by_line(group)
    parts += [published_frame()] * published
    verified = {*titles}
    for name, read in files:
        # named after its values, so that a results file written from this page does not share the name of another file
        here = f"file {digest_of_bytes(results_csv(read).encode(), size=4)}"
        names = {}
        for of in read["sample_set"].unique(maintain_order=True):
            names[of] = here if of == FILE else f"{here}, {of}" if of in verified else of
            titles[names[of]] = f"Claimed: {plain(name if of == FILE else f'{name}, sample set {of}', 80)}"
        parts.append(read.with_columns(pl.col("sample_set").replace(names)))
    if not any(part.height for part in parts):
        raise UsageError("nothing to show: give runs or results files, or include the published results")
    frame = pl.concat(parts)
    lines = lines_of(frame, run_of, with_paper)
    return Content(title, frame, lines, page_ids(lines), titles, alone)


_LONGEST_ID = 40


def page_ids(lines: Iterable[ModelResult]) -> dict[ModelResult, str]:
    """Map each line to the id of its model's page. Ids consist of letters, digits and hyphens, so they are safe in URLs
    and attributes. Lines of one model on the same frames share a page.

    >>> names = ("SAMFlow-H", "samflow h", "<>")
    >>> list(page_ids(ModelResult("demo", "frames", "OOD", name, "", {}) for name in names).values())
    ['samflow-h', 'samflow-h-2', 'model']
    """
    ids: dict[ModelResult, str] = {}
    of_key: dict[tuple[str, str], str] = {}
    used: set[str] = set()
    numbers: defaultdict[str, Iterator[int]] = defaultdict(lambda: count(2))
    for line in lines:
        if line.key not in of_key:
            words = line.name.replace("+", " plus ").lower()
            stem = re.sub(r"[^a-z0-9]+", "-", words)[:_LONGEST_ID].strip("-") or "model"
            slugs = chain([stem], (f"{stem}-{number}" for number in numbers[stem]))
            of_key[line.key] = next(slug for slug in slugs if slug not in used)
            used.add(of_key[line.key])
        ids[line] = of_key[line.key]
    return ids
