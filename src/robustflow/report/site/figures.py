"""The figures of a page, each with the table of what it shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice

from markupsafe import Markup

from ...analysis.displacements import displacements_of
from ...analysis.doubts import sound_results
from ...errors import UsageError
from ...text import plain
from ..figures import displacement_figure, figures_by_sample_set, severity_curves
from ..figures.canvas import SERIES
from ..figures.marks import MarkedFigure
from ..figures.severity_curves import share_scale
from .content import Content
from .entries import default_order
from .svg import inline_svg

_TEXTS = {
    "clean_against_cre": (
        "Accuracy against robustness",
        "Clean EPE to the right, CRE upwards, the area of a bubble is CREr: best is a small bubble at the lower left.",
    ),
    "crer_by_family": (
        "Relative robustness by class of corruption",
        "Bars of CREr for each class of corruptions, one colour per setting: what fine-tuning on the domain costs.",
    ),
    "relations": (
        "How the numbers are related",
        "Four panels, a point per model: corrupted EPE, CRE and RCRE against clean EPE, and RCRE against CRE.",
    ),
    "effective_trend": (
        "Effective robustness",
        "Corrupted against clean EPE with the trend of the models: below the line is more robust than the clean error "
        "predicts.",
    ),
    "displacement": (
        "How far pixels move",
        "Share of the pixels by the length of their flow on the clean frames: what makes a benchmark hard to begin "
        "with.",
    ),
    "severity_curves": (
        "Severity curves",
        "RCRE at each severity, a panel per corruption, a line per run; bands are 95 % confidence intervals.",
    ),
}
_MOST_LINES = 200


@dataclass(frozen=True)
class PageFigure:
    """A figure: `svg` is markup, `apart` the same with a scale for each panel where the panels of `svg` share one,
    `columns` and `lines` give the same as numbers, empty if tables elsewhere do; `head` is what a line is of; `wide` if
    it has many panels."""

    id: str
    title: str
    description: str
    frames: str
    svg: Markup
    apart: Markup | None
    wide: bool
    head: str
    columns: tuple[str, ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]


def page_figures(content: Content) -> list[PageFigure]:
    """Figures of each sample set that the page is about, the severity curves of its runs and how far pixels move in
    their frames, eight per figure."""
    drawn: list[tuple[str, str, MarkedFigure]] = []
    for frames, figures in figures_by_sample_set(sound_results(content.focus, content.doubted)).items():
        drawn += [(frames, name, figure) for name, figure in figures.items() if _compares(name, figure)]
    notes: dict[tuple[str, str], str] = {}
    for frames, _ in content.doubted:
        names = [plain(name) for of, name in content.doubted if of == frames]
        not_drawn = f"Not drawn, because not ranked: {', '.join(names)}. "
        notes |= {(frames, name): not_drawn for of, name, _ in drawn if of == frames}
    for frames in dict.fromkeys(frames for frames, _ in content.runs):
        runs = _best_runs(frames, content)
        count = sum(of == frames for of, _ in content.runs)
        if count > len(runs):
            notes[frames, "severity_curves"] = f"The {len(runs)} of {count} runs with the lowest error are drawn. "
        try:
            curves = severity_curves({name: content.runs[frames, name].rows for name in runs})
        except UsageError:
            # Runs in which no pixel could be measured have no curve.
            continue
        drawn.append((frames, "severity_curves", curves))
    moved = iter(displacements_of(list(content.runs.values())).items())
    while lines := dict(islice(moved, len(SERIES))):
        drawn.append(("", "displacement", displacement_figure(lines)))
    made = []
    for index, (of, name, drawing) in enumerate(drawn):
        one = _page_figure(f"figure-{index}", of, name, drawing, content)
        made.append(replace(one, frames=one.frames + notes.get((of, name), "")))
    return made


def _best_runs(frames: str, content: Content) -> list[str]:
    """Names of the runs of a sample set, at most as many as a figure can distinguish, in the order of the runs; if
    there are more, those that are first on the leaderboard."""
    names = [name for of, name in content.runs if of == frames]
    if len(names) <= len(SERIES):
        return names
    entries = sorted((entry for entry in content.entries if entry.sample_set == frames), key=default_order)
    best = {entry.name for entry in entries[: len(SERIES)]}
    return [name for name in names if name in best]


def _compares(name: str, figure: MarkedFigure) -> bool:
    """Whether there is something to see: a single point is not a distribution."""
    return name == "crer_by_family" or len({mark.model for marks in figure.marks.values() for mark in marks}) > 1


def _page_figure(id_: str, frames: str, name: str, figure: MarkedFigure, content: Content) -> PageFigure:
    pages = {entry.name: entry.page for entry in content.entries if entry.sample_set == frames}
    title, description = _TEXTS[name]
    if figure.get_suptitle():
        figure.suptitle("")  # The page has its own heading.
    marks = dict.fromkeys(mark for of_artist in figure.marks.values() for mark in of_artist if mark.values)
    columns = tuple(dict.fromkeys(what for mark in marks for what, _ in mark.values))
    lines = tuple((plain(mark.model), tuple(dict(mark.values).get(what, "–") for what in columns)) for mark in marks)
    if any(mark.setting for mark in marks):
        columns = ("Setting", *columns)
        lines = tuple(
            (head, (plain(mark.setting, 40), *values)) for mark, (head, values) in zip(marks, lines, strict=True)
        )
    apart = None
    if name == "severity_curves" and len(figure.axes) > 1:
        apart = inline_svg(figure, f"{id_}-apart", title, description, pages.get)
        share_scale(figure)
    svg = inline_svg(figure, id_, title, description, pages.get)
    return PageFigure(
        id=id_,
        title=title,
        description=description,
        frames=content.group_titles.get(frames, plain(frames)) + ". " if frames else "",
        svg=svg,
        apart=apart,
        wide=figure.get_figwidth() > 9,
        head="Frames" if name == "displacement" else "Model",
        columns=columns,
        lines=lines if len(lines) <= _MOST_LINES else (),
    )
