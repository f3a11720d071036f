"""Render a page as one self-contained HTML file, and write the report page of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import polars as pl
from jinja2 import Environment
from markupsafe import Markup

from ...core.errors import RunError
from ...core.text import plain
from ...core.version import VERSION
from ...corruptions.registry import ordered
from ...media.images import png_address
from ...run.run import Run
from ...stats.audit import AUDIT_CHECKS, audit_results
from ...stats.model_result import ModelResult, by_frames
from ...stats.published.tables import PAPER
from ...stats.results import AVERAGE, CLEAN, long_label, metric_label
from ..attack_tables import attack_table, prediction_table
from ..gallery import slider
from ..gallery.layout import colour_wheel, error_scale
from ..leaderboard import by_error
from ..notebook import asset, content_policy, json_block, templates
from ..render.html import render as render_table
from ..run_tables import confidence_table
from ..table import Column, Table
from .content import MOST_DETAILED, Content, run_content
from .data import page_data
from .examples import Examples, examples_of
from .figures import FigureGroup, PageFigure, attack_figure, page_figures
from .headline import headline_of

_PACKAGE = "robustflow.report.site"
_SCRIPTS = ("elements.js", "models.js", "state.js", "board.js", "figures.js", "downloads.js")
_FINDING_COLUMNS = (Column("Source", prose=True), "Setting", "given", "recomputed")
REPORT = "report.html"
Figures = tuple[Content, list[FigureGroup]]


def render_site(
    content: Content, gallery: slider.Slider | None = None, figures: Sequence[FigureGroup] | None = None
) -> str:
    """Render the page of a content; `gallery` is shown if no run has pictures."""
    order = [board.name for board in content.boards]
    runs = sorted((line for line in content.lines if line.run), key=lambda line: order.index(line.benchmark))
    examples = examples_of(runs) or (Examples(gallery) if gallery else None)
    figures = page_figures(content) if figures is None else figures
    pictured = next(iter(examples.panels)).benchmark if examples and examples.panels else None
    return (
        _environment()
        .get_template("page.html")
        .render(
            content=content,
            sections=[
                {
                    "board": board,
                    "headline": headline_of(content, board, examples.panels if examples else {}),
                    "figures": [group for group in figures if group.benchmark == board.name],
                    "corruptions": list(_by_corruption(content, board.name)),
                    "audits": _audits(content, board.name),
                }
                for board in content.boards
            ],
            warnings=_warnings(runs),
            attacks=_attacks(runs),
            confidences=[
                (plain(line.name), table, None) for line in runs if line.run and (table := confidence_table(line.run))
            ],
            primary=content.pages[runs[0]] if content.of_one_run else "",
            examples=examples,
            pictured=None if pictured is None else order.index(pictured),
            slider=slider.slider_markup(examples.slider) if examples else None,
            data=json_block(page_data(content, examples.panels if examples else {})),
            wheel=png_address(colour_wheel(80)),
            scale=png_address(error_scale(256)),
            style=_style(),
            script=_script(),
            policy=content_policy(_script()),
            version=VERSION,
        )
    )


def draw_figures(run: Run) -> Figures:
    """Draw the figures of a run's report, which may be done before its example pictures exist."""
    content = run_content(run)
    return content, page_figures(content)


def write_report(run: Run, drawn: Figures | None = None) -> None:
    """Write `report.html`, with any existing example pictures, to a run's folder unless it is up to date."""

    def rendered() -> bytes:
        content, figures = draw_figures(run) if drawn is None else drawn
        return render_site(content, figures=figures).encode()

    if run.derived.write_file(REPORT, rendered, shows_others=True):
        run.keep()


def _audits(content: Content, benchmark: str) -> list[tuple[str, str, list[tuple[str, int, Table]]]]:
    """Audit the values of a benchmark in the paper's tables and in results files. Return what was audited, its outcome,
    and the name, the number of values and the findings of each check."""
    out = []
    without_rows = content.frame.filter(pl.col("source").is_in(["published", "claimed"]), benchmark=benchmark)
    for (frames,), numbers in without_rows.group_by("sample_set", maintain_order=True):
        if frames == PAPER and content.alone:
            continue
        audited = "the published tables" if frames == PAPER else content.group_titles[str(frames)]
        audit = audit_results(numbers, audited)
        checks = []
        for check, count in audit.checked.items():
            rows = [
                (plain(one.message, 400), (one.source, one.setting, one.given, one.recomputed))
                for one in audit.findings
                if one.check == check
            ]
            table = Table.of("findings", "", _FINDING_COLUMNS, {"": rows}, row_header="Finding", keep_empty=True)
            checks.append((AUDIT_CHECKS[check], count, table))
        outcome = f"{len(audit.findings)} of {sum(audit.checked.values())} compared numbers are inconsistent"
        out.append((audited, outcome, checks))
    return out


def _by_corruption(content: Content, benchmark: str) -> Iterator[Table]:
    """Yield a table of the headline's measure for each group of runs on the same frames: a corruption in each row."""
    for frames, lines in by_frames(line for line in content.lines if line.run and line.benchmark == benchmark).items():
        metric = next((name for name in ("epe", "rcre") if any(line.numbers(name) for line in lines)), "epe")
        names = ordered({name for line in lines for name in line.numbers(metric)} - {CLEAN, AVERAGE})
        if len(lines) < 2 or not names:
            continue
        best = sorted(lines, key=by_error)[:MOST_DETAILED]
        columns = [plain(line.name, 40) for line in best]
        rows = [(plain(long_label(name)), [line.number(metric, name) for line in best]) for name in names]
        sections = {content.group_titles.get(frames, ""): rows}
        yield Table.of("by-corruption", f"{metric_label(metric)} by corruption", columns, sections, (), "Corruption")


def _warnings(runs: Sequence[ModelResult]) -> list[tuple[str, str]]:
    """Return the benchmark of each incomplete run and of each run with invalid predictions, with a warning."""
    out = []
    for line in runs:
        assert line.run is not None
        measured, name = line.run.measured, plain(line.name)
        if not measured.complete:
            out.append((line.benchmark, f"{name}: incomplete; the means are over the available rows."))
        if measured.n_invalid:
            out.append(
                (
                    line.benchmark,
                    f"{name}: {measured.n_invalid} predicted pixels were NaN or infinite; no mean has them.",
                )
            )
    return out


def _attacks(lines: Sequence[ModelResult]) -> list[tuple[str, Table, PageFigure | None]]:
    """Return the name, the table and the security curves of each run with attacks, and the correlation over models."""
    tables = [(plain(line.name), line.run, attack_table(line.run)) for line in lines if line.run]
    out: list[tuple[str, Table, PageFigure | None]] = [
        (name, table, attack_figure(at, run)) for at, (name, run, table) in enumerate(tables) if table is not None
    ]
    try:
        predicted = prediction_table([line.run for line in lines if line.run])
    except RunError:  # the runs have no frames in common, so there is no correlation
        return out
    return [*out, (predicted.title, predicted, None)] if predicted else out


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
    environment.globals["render_table"] = lambda table: Markup(render_table(table))
    return environment
