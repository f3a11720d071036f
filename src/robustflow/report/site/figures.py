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
from ...run.displacement import displacements_of
from ...stats.lines import LineKey, Numbers, by_sample_set, ranked
from ...stats.published.tables import PAPER
from ...stats.results import AVERAGE
from ..attack_tables import security_points
from ..figures import OF_ONE_MODEL, FigureStyles, displacement_figure, figures_by_sample_set, severity_curves
from ..figures.canvas import MarkedFigure
from ..figures.curves import MOST_LINES, scale_panels, security_figure, sparsification_curves
from ..figures.styles import MODEL_STYLES, Style, nth_style
from ..leaderboard import by_error
from ..table import Table
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
_MOST_NUMBERS = 200


@dataclass(frozen=True)
class PageFigure:
    """A figure of a page. The numbers are None if the model pages show them all; `apart` is a second drawing, with a
    separate scale for each panel."""

    id: str
    title: str
    caption: str
    svg: Markup
    apart: Markup | None
    key: Markup
    wide: bool
    numbers: Table | None


@dataclass(frozen=True)
class FigureGroup:
    """A group of figures for results measured on the same frames."""

    benchmark: str
    title: str
    figures: tuple[PageFigure, ...]


def page_figures(content: Content) -> list[FigureGroup]:
    """Draw the figures of each sample set that the page is about, including the severity curves of its runs and the
    flow magnitudes of their frames. A model has the same colour in all figures."""
    styling = page_styles(content)
    groups: list[FigureGroup] = []
    count = 0
    for benchmark, sample_set in dict.fromkeys(key[:2] for key in content.focus):
        drawn: list[tuple[str, MarkedFigure, str]] = []
        lines = {key: numbers for key, numbers in content.focus.items() if key[:2] == (benchmark, sample_set)}
        part = ranked(lines)
        excluded = [plain(key.model) for key in lines if key not in part]
        note = f"Not drawn because not ranked: {', '.join(excluded)}. " if excluded else ""
        kinds = {} if len({key.model for key in part}) > 1 else {"names": OF_ONE_MODEL}
        for figures in figures_by_sample_set(part, styling, **kinds).values():
            drawn += [(name, figure, note) for name, figure in figures.items() if _compares(name, figure)]
        drawn += _run_figures(sample_set, content, styling)
        pages = {key.model: content.pages[key] for key in lines}
        made = [_page_figure(f"figure-{count + index}", *one, pages) for index, one in enumerate(drawn)]
        count += len(made)
        if made:
            made.sort(key=lambda figure: figure.wide)  # narrow figures, which fit side by side, come first
            groups.append(FigureGroup(benchmark, content.group_titles.get(sample_set, plain(sample_set)), tuple(made)))
    return groups


def attack_figure(number: int, numbers: Numbers) -> PageFigure | None:
    """Draw the security curves of a run; None if it has no attacks."""
    points = security_points(numbers)
    return _page_figure(f"attacks-{number}", "security_curves", security_figure(points), "", {}) if points else None


def page_styles(content: Content) -> FigureStyles:
    """Assign a distinct style to each model name, the same in every sample set."""
    places: dict[tuple[str, int], int] = {}
    styles: dict[LineKey, Style] = {}
    own = {key: numbers for key, numbers in content.lines.items() if key.sample_set != PAPER}
    for lines in by_sample_set(own).values():
        counts: Counter[str] = Counter()
        for key, _ in sorted(lines.items(), key=by_error):
            name = content.runs[key].name if key in content.runs else key.model
            place = places.setdefault((name, counts[name]), len(places))
            styles[key] = nth_style(place)
            counts[name] += 1
    return FigureStyles(styles, legend="")


def _run_figures(sample_set: str, content: Content, styling: FigureStyles) -> Iterable[tuple[str, MarkedFigure, str]]:
    """Yield the figures of runs, as (name, figure, sentence about omitted runs). If there are more runs than a
    figure can distinguish, only the top runs of the leaderboard have curves."""
    of_runs = {
        key: numbers for key, numbers in content.lines.items() if key.sample_set == sample_set and key in content.runs
    }
    best = dict(sorted(of_runs.items(), key=by_error)[: len(MODEL_STYLES)])
    runs = {key.model: numbers for key, numbers in of_runs.items() if key in best}
    with suppress(UsageError):  # runs without valid pixels have no curve
        styles = {key.model: styling.styles[key] for key in best}
        metric = "epe" if any(("epe", AVERAGE, None) in numbers for numbers in runs.values()) else "rcre"
        curves = severity_curves(runs, metric, styles=styles, legend=bool(styling.legend))
        fewer = len(runs) < len(of_runs)
        note = f"The {len(runs)} of {len(of_runs)} runs with the lowest error are drawn. " if fewer else ""
        yield "severity_curves", curves, note
    for name, numbers in runs.items():
        with suppress(UsageError):  # the run has no confidence, or no ground truth
            yield "sparsification", sparsification_curves(plain(name), numbers), ""
    moved = iter(displacements_of([content.runs[key] for key in of_runs]).items())
    while histograms := dict(islice(moved, MOST_LINES)):
        yield "displacement", displacement_figure(histograms), ""


def _compares(name: str, figure: MarkedFigure) -> bool:
    """Whether a figure compares models, or says something about one."""
    return name in OF_ONE_MODEL or len({mark.model for marks in figure.marks.values() for mark in marks}) > 1


def _page_figure(id_: str, name: str, figure: MarkedFigure, note: str, pages: dict[str, str]) -> PageFigure:
    if figure.get_suptitle():
        figure.suptitle("")  # the page provides the heading
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
        numbers=_numbers({"displacement": "Frames", "security_curves": "Attack"}.get(name, "Model"), figure),
    )


def _numbers(head: str, figure: MarkedFigure) -> Table | None:
    """Tabulate the values of a figure's marks; None if there are too many for a table."""
    marks = dict.fromkeys(mark for of_artist in figure.marks.values() for mark in of_artist if mark.values)
    if len(marks) > _MOST_NUMBERS:
        return None
    known = [{"Setting": plain(mark.setting, 40)} | dict(mark.values) for mark in marks]
    labels = [
        label for label in dict.fromkeys(key for one in known for key in one) if any(one.get(label) for one in known)
    ]
    rows = [
        (plain(mark.model), [values.get(label) or None for label in labels])
        for mark, values in zip(marks, known, strict=True)
    ]
    return Table.of("figure", "", labels, {"": rows}, row_header=head)
