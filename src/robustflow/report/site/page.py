"""Render a page as HTML. The templates escape everything that comes from a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from jinja2 import Environment
from markupsafe import Markup

from ...analysis.audit import Audit
from ...analysis.model_result import ModelResult
from ...analysis.published.tables import PAPER
from ...errors import RunError
from ...runs.run import Run
from ...text import plain
from ...version import VERSION
from .. import slider
from ..attack_table import attack_table, prediction_table
from ..confidence_table import confidence_table
from ..embed import asset, content_policy, json_block, templates
from ..leaderboard import Board
from ..render.html import render as render_table
from ..table import Table
from .content import Content
from .data import page_data
from .examples import Examples, examples_of
from .figures import FigureGroup, PageFigure, attack_figure, page_figures
from .findings import audits, by_check
from .headline import headline
from .models import model_pages

_PACKAGE = "robustflow.report.site"
_SCRIPTS = ("elements.js", "models.js", "state.js", "board.js", "figures.js", "findings.js", "downloads.js")


def render_site(content: Content, gallery: slider.Slider | None = None) -> str:
    """Render the page as one self-contained HTML file."""
    order = [board.benchmark for board in content.boards]
    runs = sorted((line for line in content.lines if line.run), key=lambda line: order.index(line.benchmark))
    examples = examples_of(runs) or (Examples(gallery) if gallery else None)
    pages = model_pages(content, examples.panels if examples else {})
    sections = _sections_of(content, page_figures(content))
    pictured = next(iter(examples.panels)).benchmark if examples and examples.panels else None
    return (
        _environment()
        .get_template("page.html")
        .render(
            content=content,
            attacks=_attacks(runs),
            predictions=_predictions([line.run for line in runs if line.run]),
            confidences=[
                (line.name, table) for line in runs if line.run and (table := confidence_table(line.run)) is not None
            ],
            sections=sections,
            primary=pages[0].id if content.of_one_run else "",
            examples=examples,
            pictured=None if pictured is None else order.index(pictured),
            slider=slider.slider_markup(examples.slider) if examples else None,
            data=json_block(page_data(content, pages)),
            style=_style(),
            script=_script(),
            policy=content_policy(_script()),
            version=VERSION,
        )
    )


def _attacks(lines: Sequence[ModelResult]) -> list[tuple[str, Table, PageFigure | None]]:
    """Return the name, the table and the security curves of each run with attacks."""
    tables = [(line.name, line.run, attack_table(line.run)) for line in lines if line.run]
    return [(name, table, attack_figure(at, run)) for at, (name, run, table) in enumerate(tables) if table is not None]


def _predictions(runs: Sequence[Run]) -> Table | None:
    try:
        return prediction_table(runs)
    except RunError:  # the runs have no frames in common, so there is no correlation
        return None


@dataclass(frozen=True)
class BenchmarkSection:
    """The part of a page about one benchmark; the page shows one benchmark at a time."""

    board: Board
    headline: Sequence[str]
    figures: Sequence[FigureGroup]
    audits: Sequence[Audit]


def _sections_of(content: Content, figures: Sequence[FigureGroup]) -> list[BenchmarkSection]:
    return [
        BenchmarkSection(
            board=board,
            headline=headline(content, board.benchmark),
            figures=[group for group in figures if group.benchmark == board.benchmark],
            audits=audits(content, board.benchmark),
        )
        for board in content.boards
    ]


@cache
def _style() -> Markup:
    """Return the style sheet. It ships with the package, so it is not escaped."""
    return Markup(asset(_PACKAGE, "site.css")) + slider.style()


@cache
def _script() -> Markup:
    """Concatenate all scripts, each in a separate scope."""
    scripts = (*(asset(_PACKAGE, name) for name in _SCRIPTS), slider.script())
    return Markup("".join(f"(() => {{\n{text}}})();\n" for text in scripts))


@cache
def _environment() -> Environment:
    environment = templates(_PACKAGE)
    environment.globals.update(
        by_check=by_check,
        paper=PAPER,
        plain=plain,
        render_table=lambda table: Markup(render_table(table)),
    )
    return environment
