"""Content of a page: runs, results files, and the paper's results."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count

import polars as pl

from ...core.errors import UsageError
from ...core.files import digest_of_bytes
from ...core.text import plain
from ...run.comparable import run_names, sample_set
from ...run.run import Run
from ...stats.exclusion import exclusion_reasons
from ...stats.frame import VERDICT, once, results_frame
from ...stats.intervals import interval_ends
from ...stats.lines import LineKey, Lines, Numbers, lines_of
from ...stats.notes import comparison_notes
from ...stats.numbers import NUMBERS
from ...stats.published.tables import PAPER, published_frame
from ...stats.results import benchmark_words
from ...stats.results_file import FILE, results_csv
from ...stats.verdict import Verdict, verdict_of
from ..leaderboard import boards_of
from ..table import Table

MOST_DETAILED = 24
"""Maximum number of runs for which a page shows pictures and an interval for every corruption. With more runs, only the
averages have intervals."""
KINDS = ("means", "facts", "confidence", "uncoupled", "attacks", VERDICT)
"""The parts of the results frame that a page shows."""


@dataclass(frozen=True)
class Content:
    """The content of a page: the results frame, and of its runs what is not a number.

    Attributes:
        runs: by line, for pictures and texts.
        pages: ids of the model pages.
        group_titles: titles of the sample sets.
        alone: whether the page shows only its runs.
        asked: a measure that the reader asked for; may be "".
    """

    title: str
    frame: pl.DataFrame
    runs: Mapping[LineKey, Run]
    group_titles: Mapping[str, str]
    alone: bool
    asked: str = ""

    @cached_property
    def lines(self) -> Lines:
        """The lines of the frame."""
        return lines_of(self.frame)

    @cached_property
    def pages(self) -> dict[LineKey, str]:
        """The id of the model page of each line."""
        return page_ids(self.lines)

    @property
    def of_one_run(self) -> bool:
        """Whether the page is the report of a single run; the model's page then comes first."""
        return self.alone and len(self.runs) == 1

    @cached_property
    def boards(self) -> list[Table]:
        """The leaderboards, one per benchmark."""
        return boards_of(self.lines, self.group_titles, self.asked)

    @cached_property
    def verdicts(self) -> dict[tuple[str, str, str], Verdict]:
        """The verdict on the ranked runs of each setting on the same frames."""
        parts = self.frame.filter(excluded="").partition_by("benchmark", "sample_set", "setting", as_dict=True)
        return {
            (str(benchmark), str(of), str(setting)): verdict_of(part)
            for (benchmark, of, setting), part in parts.items()
            if part["against"].count()
        }

    @property
    def focus(self) -> dict[LineKey, Numbers]:
        """The lines that the page is about."""
        return {key: numbers for key, numbers in self.lines.items() if not (self.alone and key.sample_set == PAPER)}


def run_content(run: Run, asked: str = "") -> Content:
    """Return the content of a run's report: the run first, followed by the paper's lines. The table of the first screen
    has a measure that is `asked` for."""
    title = f"{run.name} on {benchmark_words(run.benchmark)}"
    return _content(plain(title, 160), [run], [], published=True, alone=True, asked=asked)


def whole_content(
    runs: Sequence[Run],
    files: Sequence[tuple[str, pl.DataFrame]] = (),
    *,
    published: bool = True,
    asked: str = "",
) -> Content:
    """Return the content of a leaderboard, whose first table has a measure that is `asked` for."""
    return _content("Robustness of optical flow", runs, files, published, alone=False, asked=asked)


def _content(
    title: str, runs: Sequence[Run], files: Sequence[tuple[str, pl.DataFrame]], published: bool, alone: bool, asked: str
) -> Content:
    # a page about its runs averages over all corruptions of each run, although it also shows the paper's lines
    with_paper, detailed = published and not alone, len(runs) <= MOST_DETAILED
    of_frames: dict[str, list[Run]] = {}
    for run in runs:
        of_frames.setdefault(sample_set(run), []).append(run)
        if not detailed:
            _ = run.averages, exclusion_reasons(run), interval_ends(run, corruptions=False, beside_published=with_paper)
            _ = NUMBERS["uncoupled"](run, with_paper)
            run.release_rows()
    note_of_run = dict(zip(map(id, runs), comparison_notes(runs, with_paper), strict=True))
    parts: list[pl.DataFrame] = []
    run_of: dict[LineKey, Run] = {}
    titles = {PAPER: "Published values"}
    for of, group in of_frames.items():
        notes = [note_of_run[id(run)] for run in group]
        titles[of] = f"Measured: {notes[0] or 'the frames of the paper'}"
        parts.append(results_frame(group, KINDS, notes=notes, detailed=detailed, beside_published=with_paper))
        run_of |= {LineKey(r.benchmark, of, r.setting, n): r for r, n in zip(group, run_names(group), strict=True)}
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
    return Content(title, once(pl.concat(parts)), run_of, titles, alone, asked)


_LONGEST_ID = 40


def page_ids(lines: Iterable[LineKey]) -> dict[LineKey, str]:
    """Map each line to the id of its model's page. Ids consist of letters, digits and hyphens, so they are safe in URLs
    and attributes. Lines of one model on the same frames share a page.

    >>> names = ("SAMFlow-H", "samflow h", "<>")
    >>> list(page_ids(LineKey("demo", "frames", "OOD", name) for name in names).values())
    ['samflow-h', 'samflow-h-2', 'model']
    """
    ids: dict[LineKey, str] = {}
    of_model: dict[tuple[str, str], str] = {}
    used: set[str] = set()
    numbers: defaultdict[str, Iterator[int]] = defaultdict(lambda: count(2))
    for line in lines:
        model = line.sample_set, line.model
        if model not in of_model:
            words = line.model.replace("+", " plus ").lower()
            stem = re.sub(r"[^a-z0-9]+", "-", words)[:_LONGEST_ID].strip("-") or "model"
            slugs = chain([stem], (f"{stem}-{number}" for number in numbers[stem]))
            of_model[model] = next(slug for slug in slugs if slug not in used)
            used.add(of_model[model])
        ids[line] = of_model[model]
    return ids
