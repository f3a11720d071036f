"""The figures of a page, each with the table of what it shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from markupsafe import Markup

from ...analysis.confidence import confidence_scores
from ...analysis.displacements import displacements_of
from ...analysis.model_result import ModelResult, by_frames, ranked
from ...analysis.published.tables import PAPER
from ...analysis.security_curves import security_curves
from ...errors import UsageError
from ...runs.run import Run
from ...text import plain
from ..figures import Looks, displacement_figure, figures_by_sample_set, severity_curves
from ..figures.displacement_histogram import MOST_LINES
from ..figures.marks import MarkedFigure
from ..figures.security_curves import security_figure
from ..figures.severity_curves import scale_panels
from ..figures.sparsification_curves import sparsification_curves
from ..figures.styles import MODEL_STYLES, OTHER, Style
from ..leaderboard import by_error
from .content import Content
from .svg import inline_svg, key_markup

_TITLES = {
    "clean_against_cre": "Accuracy against robustness",
    "crer_by_family": "Relative robustness by class of corruption",
    "relations": "How the numbers are related",
    "effective_trend": "Effective robustness",
    "severity_curves": "Severity curves",
    "displacement": "How far pixels move",
    "security_curves": "Security curves",
    "sparsification": "Does it know when it is wrong",
}
_MOST_LINES = 200


@dataclass(frozen=True)
class PageFigure:
    """A figure.

    Attributes:
        id, title, caption: what it shows.
        svg: its panels as markup; `apart` the same with a scale for each panel where those of `svg` share one.
        key: what its colours and markers mean, as markup.
        wide: whether it has many panels.
        head: heading of the first column of the numbers.
        columns, lines: the same as numbers, empty if tables elsewhere give them.
    """

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
    """The figures of what was measured on the same frames.

    Attributes:
        benchmark: what they are of.
        title: of the frames, as in the leaderboard.
        figures: of one group.
    """

    benchmark: str
    title: str
    figures: tuple[PageFigure, ...]


def page_figures(content: Content) -> list[FigureGroup]:
    """Figures of each sample set that the page is about, with the severity curves of its runs and how far pixels move
    in their frames. A model has the same colour in all of them."""
    looks = page_looks(content)
    groups = []
    count = 0
    for benchmark, frames in dict.fromkeys((line.benchmark, line.frames) for line in content.focus):
        drawn: list[tuple[str, MarkedFigure, str]] = []
        of_frames = [line for line in content.focus if line.frames == frames]
        part = ranked(line for line in of_frames if line.benchmark == benchmark)
        excluded = [plain(line.name) for line in of_frames if line.excluded]
        note = f"Not drawn, because not ranked: {', '.join(excluded)}. " if excluded else ""
        for figures in figures_by_sample_set(part, looks).values():
            drawn += [(name, figure, note) for name, figure in figures.items() if _compares(name, figure)]
        drawn += _of_runs(frames, content, looks)
        pages = {line.name: page for line, page in content.pages.items() if line.frames == frames}
        made = []
        for name, figure, note in drawn:
            made.append(_page_figure(f"figure-{count}", name, figure, note, pages))
            count += 1
        if made:
            made.sort(key=lambda figure: figure.wide)  # those that fit beside each other first
            groups.append(FigureGroup(benchmark, content.group_titles.get(frames, plain(frames)), tuple(made)))
    return groups


def attack_figure(number: int, run: Run) -> PageFigure | None:
    """The security curves of a run; None if it has no attacks."""
    points = security_curves(run)
    if not points:
        return None
    return _page_figure(f"attacks-{number}", "security_curves", security_figure(points, legend=False), "", {})


def page_looks(content: Content) -> Looks:
    """The looks of the models: those of one name are alike in every sample set, and nothing else is."""
    places: dict[tuple[str, int], int] = {}
    styles: dict[ModelResult, Style] = {}
    for lines in by_frames(line for line in content.lines if line.frames != PAPER).values():
        seen: Counter[str] = Counter()
        for line in sorted(lines, key=by_error):
            name = line.name if line.run is None else line.run.name
            place = places.setdefault((name, seen[name]), len(places))
            styles[line] = MODEL_STYLES[place] if place < len(MODEL_STYLES) else OTHER
            seen[name] += 1
    return Looks(styles, legend=False)


def _of_runs(frames: str, content: Content, looks: Looks) -> Iterable[tuple[str, MarkedFigure, str]]:
    """(name, figure, what it leaves out) of the figures that need rows."""
    of_frames = {line.name: line.run for line in content.lines if line.frames == frames and line.run is not None}
    styles = {line.name: looks.styles[line] for line in content.lines if line.frames == frames and line.run}
    runs = _best_runs(list(of_frames), frames, content)
    try:
        curves = severity_curves({name: of_frames[name].rows for name in runs}, styles=styles, legend=looks.legend)
    except UsageError:
        pass  # Runs in which no pixel could be measured have no curve.
    else:
        fewer = len(runs) < len(of_frames)
        note = f"The {len(runs)} of {len(of_frames)} runs with the lowest error are drawn. " if fewer else ""
        yield "severity_curves", curves, note
    for name in runs:
        with suppress(UsageError):  # without a confidence, or without ground truth
            yield "sparsification", sparsification_curves(plain(name), confidence_scores(of_frames[name])), ""
    moved = iter(displacements_of(list(of_frames.values())).items())
    while lines := dict(islice(moved, MOST_LINES)):
        yield "displacement", displacement_figure(lines), ""


def _best_runs(names: list[str], frames: str, content: Content) -> list[str]:
    """Names of the runs of a sample set, at most as many as a figure can distinguish, in the order of the runs; if
    there are more, those that are first on the leaderboard."""
    if len(names) <= len(MODEL_STYLES):
        return names
    lines = sorted((line for line in content.lines if line.frames == frames), key=by_error)
    best = {line.name for line in lines[: len(MODEL_STYLES)]}
    return [name for name in names if name in best]


def _compares(name: str, figure: MarkedFigure) -> bool:
    """Whether there is a distribution to see, more than a single point."""
    return name == "crer_by_family" or len({mark.model for marks in figure.marks.values() for mark in marks}) > 1


def _page_figure(id_: str, name: str, figure: MarkedFigure, note: str, pages: dict[str, str]) -> PageFigure:
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
