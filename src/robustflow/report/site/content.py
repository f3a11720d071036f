"""What a page is made from: runs, results files, and the paper's results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from ...analysis.cost_ranks import run_costs
from ...analysis.doubts import doubted_runs, doubts
from ...analysis.labels import benchmark_words
from ...analysis.published.tables import PAPER, Cost, published_costs
from ...analysis.results import RESULT_KEY
from ...analysis.run_names import run_names
from ...analysis.scores import coverage_of, notes_of, run_results, run_setting
from ...analysis.uncertainty.of_runs import interval_ends
from ...errors import DataError, UsageError
from ...runs.comparable import sample_set
from ...runs.costs import RunCost
from ...text import plain
from ..assemble import results_of
from .entries import Interval, LeaderboardEntry, NumberKey, entries_of

if TYPE_CHECKING:
    from ...runs.run import Run


MOST_DETAILED = 24
"""The most runs for which a page shows intervals of every corruption, and pictures; with more, only intervals of the
averages."""


@dataclass(frozen=True)
class Content:
    """What a page is made from.

    Attributes:
        title: of the page.
        runs: (sample set, name) -> run.
        results: of everything, columns of `results.RESULT_SCHEMA`.
        costs: the paper's, empty if its results are not shown.
        entries: the lines of the leaderboard.
        group_titles: sample set -> heading.
        alone: whether the page is about its runs, and the paper's results are only shown for comparison: then there are
            no figures, observations and audit of the latter.
        doubted: (sample set, name) of a run -> why its model is not ranked.
        of_paper: whether the runs' averages are over the paper's corruptions only, for comparison with the published
            ones.
    """

    title: str
    runs: Mapping[tuple[str, str], Run]
    results: pl.DataFrame
    costs: Mapping[str, Cost]
    entries: Sequence[LeaderboardEntry]
    group_titles: Mapping[str, str]
    alone: bool
    doubted: Mapping[tuple[str, str], str]
    of_paper: bool

    @property
    def of_one_run(self) -> bool:
        """Whether the page is the report of a single run, whose own page then comes first."""
        return self.alone and len(self.runs) == 1

    @property
    def focus(self) -> pl.DataFrame:
        """The results that the page is about."""
        return self.results.filter(pl.col("sample_set") != PAPER) if self.alone else self.results


def run_content(run: Run) -> Content:
    """The content of a run's own report: the run first, the paper's lines below."""
    title = f"{run.name} on {benchmark_words(run.benchmark)}"
    return _content(plain(title, 160), [run], [], published=True, alone=True)


def whole_content(
    runs: Sequence[Run],
    files: Sequence[tuple[str, pl.DataFrame]] = (),
    *,
    published: bool = True,
    only_own: bool = False,
) -> Content:
    """The content of a leaderboard.

    Args:
        runs: none or more.
        files: (name of a file, the results read from it). Each is a sample set of its own unless its lines name one.
        published: whether the paper's results are shown as well.
        only_own: whether the page is about the runs and files, and the paper's results are only shown for comparison.

    Raises:
        DataError: a value that appears twice, in two files or in a file and the paper's results.
        UsageError: no result at all.
    """
    return _content("Robustness of optical flow", runs, files, published, alone=only_own)


def _content(
    title: str, runs: Sequence[Run], files: Sequence[tuple[str, pl.DataFrame]], published: bool, alone: bool
) -> Content:
    # A page about its runs states what was requested of each; the paper's lines are only shown below.
    beside = published and not alone
    of_frames: dict[str, list[Run]] = {}
    for run in runs:
        of_frames.setdefault(sample_set(run), []).append(run)
        if len(runs) > MOST_DETAILED:
            _ = run.summary, doubts(run), interval_ends(run, corruptions=False, beside_published=beside)
            run.release_rows()
    note_of_run = dict(zip(map(id, runs), notes_of(runs, beside), strict=True))
    by_name: dict[tuple[str, str], Run] = {}
    known: dict[tuple[str, str], Mapping[NumberKey, Interval]] = {}
    notes: dict[tuple[str, str], str] = {}
    doubted: dict[tuple[str, str], str] = {}
    spent: dict[tuple[str, str], RunCost] = {}
    covered: dict[tuple[str, str], float] = {}
    parts, titles = [], {PAPER: "Published values"}
    for frames, group in of_frames.items():
        group_notes = [note_of_run[id(run)] for run in group]
        titles[frames] = f"Measured here: {group_notes[0] or 'the frames of the paper'}"
        for run, name, note in zip(group, run_names(group), group_notes, strict=True):
            by_name[frames, name], notes[frames, name] = run, note
            known[frames, name] = interval_ends(run, corruptions=len(runs) <= MOST_DETAILED, beside_published=beside)
        doubted |= doubted_runs(group)
        spent |= run_costs(group)
        covered |= coverage_of(group)
        parts.append(run_results(group, beside, group_notes))
    for index, (name, frame) in enumerate(files, 1):
        here = f"file {index}"
        parts.append(frame.with_columns(sample_set=pl.col("sample_set").replace({"file": here})))
        titles[here] = f"From {plain(name)}"
    results = pl.concat([*parts, results_of([], published=published)])
    twice = results.filter(results.select(RESULT_KEY).is_duplicated())
    if twice.height:
        entry = twice.row(0, named=True)
        raise DataError(
            f"{entry['metric']} of '{plain(entry['model'])}' ({plain(entry['setting'])}) on {entry['corruption']} "
            f"appears twice for the sample set '{plain(entry['sample_set'])}'; give each result once"
        )
    costs = published_costs() if published else {}
    entries = entries_of(
        results,
        costs,
        known,
        spent,
        [
            (run.benchmark, frames, run_setting(run), name, notes[frames, name])
            for (frames, name), run in by_name.items()
        ],
        doubted,
        covered,
    )
    if not entries:
        raise UsageError(
            "nothing to show: there are no results; name runs or results files, or show the published ones"
        )
    return Content(title, by_name, results, costs, entries, titles, alone, doubted, beside)
