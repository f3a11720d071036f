"""Figures of a page, each with a table of its numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from markupsafe import Markup

from ...core.errors import UsageError
from ...core.text import plain
from ...run.run import Run
from ...stats.anatomy import displacements_of
from ...stats.attacks import security_curves
from ...stats.frame import confidence_means
from ...stats.model_result import ModelResult, by_frames, ranked
from ...stats.published.tables import PAPER
from ..figures import FigureStyles, displacement_figure, figures_by_sample_set, severity_curves
from ..figures.canvas import MarkedFigure
from ..figures.curves import scale_panels, security_figure, sparsification_curves
from ..figures.displacement_histogram import MOST_LINES
from ..figures.styles import MODEL_STYLES, OTHER, Style
from ..leaderboard import by_error
from .content import Content
from .svg import inline_svg, key_markup

_TITLES = {
    "clean_against_cre": "Accuracy against robustness",
    "crer_by_family": "Relative robustness by corruption class",
    "relations": "Relations between the metrics",
    "effective_trend": "Effective robustness",
    "severity_curves": "Severity curves",
    "displacement": "Flow magnitudes",
    "security_curves": "Security curves",
    "sparsification": "Does the model know when it is wrong?",
}
_MOST_LINES = 200


@dataclass(frozen=True)
class PageFigure:
    """A figure of a page."""

    id: str
    title: str
    caption: str
    svg: Markup
    apart: Markup | None
    key: Markup
    wide: bool
    head: str
    columns: tuple[str, ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True)
class FigureGroup:
    """A group of figures for results measured on the same frames."""

    benchmark: str
    title: str
    figures: tuple[PageFigure, ...]


def page_figures(content: Content) -> list[FigureGroup]:
    """Draw the figures of each sample set that the page is about, including the severity curves of its runs and the
    flow magnitudes of their frames. A model has the same colour in all figures."""
    styling = page_looks(content)
    groups = []
    count = 0
    for benchmark, frames in dict.fromkeys((line.benchmark, line.frames) for line in content.focus):
        drawn: list[tuple[str, MarkedFigure, str]] = []
        of_frames = [line for line in content.focus if line.frames == frames]
        part = ranked(line for line in of_frames if line.benchmark == benchmark)
        excluded = [plain(line.name) for line in of_frames if line.excluded]
        note = f"Not drawn because not ranked: {', '.join(excluded)}. " if excluded else ""
        for figures in figures_by_sample_set(part, styling).values():
            drawn += [(name, figure, note) for name, figure in figures.items() if _compares(name, figure)]
        drawn += _row_figures(frames, content, styling)
        pages = {line.name: page for line, page in content.pages.items() if line.frames == frames}
        made = []
        for name, figure, note in drawn:
            made.append(_page_figure(f"figure-{count}", name, figure, note, pages))
            count += 1
        if made:
            made.sort(key=lambda figure: figure.wide)  # narrow figures, which fit side by side, come first
            groups.append(FigureGroup(benchmark, content.group_titles.get(frames, plain(frames)), tuple(made)))
    return groups


def attack_figure(number: int, run: Run) -> PageFigure | None:
    """Draw the security curves of a run; None if it has no attacks."""
    points = security_curves(run)
    if not points:
        return None
    return _page_figure(f"attacks-{number}", "security_curves", security_figure(points), "", {})


def page_looks(content: Content) -> FigureStyles:
    """Assign a distinct style to each model name, the same in every sample set."""
    places: dict[tuple[str, int], int] = {}
    styles: dict[ModelResult, Style] = {}
    for lines in by_frames(line for line in content.lines if line.frames != PAPER).values():
        counts: Counter[str] = Counter()
        for line in sorted(lines, key=by_error):
            name = line.name if line.run is None else line.run.name
            place = places.setdefault((name, counts[name]), len(places))
            styles[line] = MODEL_STYLES[place] if place < len(MODEL_STYLES) else OTHER
            counts[name] += 1
    return FigureStyles(styles, legend=False)


def _row_figures(frames: str, content: Content, styling: FigureStyles) -> Iterable[tuple[str, MarkedFigure, str]]:
    """Yield the figures that need rows, as (name, figure, sentences about omitted runs)."""
    of_frames = {line.name: line.run for line in content.lines if line.frames == frames and line.run is not None}
    styles = {line.name: styling.styles[line] for line in content.lines if line.frames == frames and line.run}
    runs = _best_runs(list(of_frames), frames, content)
    try:
        curves = severity_curves({name: of_frames[name].rows for name in runs}, styles=styles, legend=styling.legend)
    except UsageError:
        pass  # runs without valid pixels have no curve
    else:
        fewer = len(runs) < len(of_frames)
        note = f"The {len(runs)} of {len(of_frames)} runs with the lowest error are drawn. " if fewer else ""
        yield "severity_curves", curves, note
    for name in runs:
        with suppress(UsageError):  # the run has no confidence, or no ground truth
            yield "sparsification", sparsification_curves(plain(name), confidence_means(of_frames[name].rows)), ""
    moved = iter(displacements_of(list(of_frames.values())).items())
    while lines := dict(islice(moved, MOST_LINES)):
        yield "displacement", displacement_figure(lines), ""


def _best_runs(names: list[str], frames: str, content: Content) -> list[str]:
    """Return the names of the runs in a sample set, in order. If there are more runs than a figure can distinguish,
    only the top runs of the leaderboard are included."""
    if len(names) <= len(MODEL_STYLES):
        return names
    lines = sorted((line for line in content.lines if line.frames == frames), key=by_error)
    best = {line.name for line in lines[: len(MODEL_STYLES)]}
    return [name for name in names if name in best]


def _compares(name: str, figure: MarkedFigure) -> bool:
    """Whether a figure compares models, or shows one model in several classes."""
    return name == "crer_by_family" or len({mark.model for marks in figure.marks.values() for mark in marks}) > 1


def _page_figure(id_: str, name: str, figure: MarkedFigure, note: str, pages: dict[str, str]) -> PageFigure:
    if figure.get_suptitle():
        figure.suptitle("")  # the page provides the heading
    marks = dict.fromkeys(mark for of_artist in figure.marks.values() for mark in of_artist if mark.values)
    columns = tuple(dict.fromkeys(what for mark in marks for what, _ in mark.values))
    lines = tuple((plain(mark.model), tuple(dict(mark.values).get(what, "–") for what in columns)) for mark in marks)
    if any(mark.setting for mark in marks):
        columns = ("Setting", *columns)
        lines = tuple(
            (head, (plain(mark.setting, 40), *values)) for mark, (head, values) in zip(marks, lines, strict=True)
        )
    apart = None
    if name == "severity_curves":
        figure.supxlabel("")
        figure.supylabel("")
        if len(figure.axes) > 1:
            scale_panels(figure, apart=True)
            apart = inline_svg(figure, f"{id_}-apart", pages.get)
            scale_panels(figure)
    return PageFigure(
        id=id_,
        title=_TITLES[name],
        caption=note + figure.caption,
        svg=inline_svg(figure, id_, pages.get),
        apart=apart,
        key=key_markup(figure.key),
        wide=len(figure.axes) > 1,
        head={"displacement": "Frames", "security_curves": "Attack"}.get(name, "Model"),
        columns=columns,
        lines=lines if len(lines) <= _MOST_LINES else (),
    )
