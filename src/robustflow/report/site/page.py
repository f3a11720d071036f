"""Findings of the audit of the tables. Render a page as HTML. The templates escape everything that comes from a
file. Write the report page in a run's folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from jinja2 import Environment
from markupsafe import Markup

from ...core.errors import RunError
from ...core.text import plain
from ...core.version import VERSION
from ...run.run import Run
from ...run.staleness import is_current, source_digest, write_made
from ...stats.audit import AUDIT_CHECKS, Audit, Finding, audit_results
from ...stats.model_result import ModelResult, by_frames
from ...stats.published.tables import PAPER
from .. import slider
from ..attack_table import attack_table, prediction_table
from ..confidence_table import confidence_table
from ..leaderboard import Board
from ..notebook import asset, content_policy, json_block, templates
from ..render.html import render as render_table
from ..table import Table
from .content import Content
from .data import page_data
from .examples import Examples, examples_of
from .figures import FigureGroup, PageFigure, attack_figure, page_figures
from .headline import headline
from .models import model_pages


def audits(content: Content, benchmark: str) -> list[Audit]:
    """Audit the values of a benchmark in the paper's tables and in results files."""
    results = [line for line in content.lines if line.benchmark == benchmark and line.run is None]
    sections = []
    for frames, lines in by_frames(results).items():
        if frames == PAPER and content.alone:
            continue
        audited = "the published tables" if frames == PAPER else content.group_titles.get(frames, plain(frames))
        sections.append(audit_results(lines, audited))
    return sections


def by_check(audit: Audit) -> list[tuple[str, int, list[Finding]]]:
    """The results as (check, number of values, findings), in the order of the checks."""
    return [
        (AUDIT_CHECKS[check], count, [finding for finding in audit.findings if finding.check == check])
        for check, count in audit.checked.items()
    ]


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


REPORT = "report.html"


def write_report(run: Run) -> None:
    """Write `report.html`, with any existing example pictures, to a run's folder unless it is up to date."""
    source = source_digest(run.path, run.rows_digest, run.manifest, beside=True)
    if is_current(run.path, REPORT, source):
        return
    from .content import run_content

    write_made(run.path, REPORT, render_site(run_content(run)).encode(), source)
    run.keep()
