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
from ...media.images import png_address
from ...run.run import Run
from ...stats.audit import AUDIT_CHECKS, audit_results
from ...stats.lines import Lines, Numbers, by_sample_set
from ...stats.numbers import confidence_of
from ...stats.published.tables import PAPER
from ...stats.results import long_label, metric_label
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
    in_order = sorted(content.runs.items(), key=lambda item: order.index(item[0].benchmark))
    examples = examples_of(dict(in_order)) or (Examples(gallery) if gallery else None)
    runs = {key: content.lines[key] for key, _ in in_order}
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
            attacks=_attacks(content, runs),
            confidences=[
                (plain(key.model), table, None)
                for key, numbers in runs.items()
                if (table := confidence_table(numbers, confidence_of(content.runs[key])))
            ],
            primary=content.pages[next(iter(runs))] if content.of_one_run else "",
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


def write_report(run: Run, drawn: Figures | None = None, asked: str = "") -> None:
    """Write `report.html`, with any existing example pictures, to a run's folder unless it is up to date. Its first
    table has the measure that is `asked` for."""

    def rendered() -> bytes:
        content, figures = (run_content(run, asked), None) if drawn is None else drawn
        return render_site(content, figures=figures).encode()

    if run.derived.write_file(REPORT, rendered, shows_others=True, made_with=asked):
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
    runs = {key: content.lines[key] for key in content.runs if key.benchmark == benchmark}
    for sample_set, lines in by_sample_set(runs).items():
        metric = next((name for name in ("epe", "rcre") if any(n.by_corruption(name) for n in lines.values())), "epe")
        names = Numbers(item for numbers in lines.values() for item in numbers.items()).corruptions((metric,))
        if len(lines) < 2 or not names:
            continue
        best = dict(sorted(lines.items(), key=by_error)[:MOST_DETAILED])
        columns = [plain(key.model, 40) for key in best]
        rows = [(plain(long_label(name)), [n.number(metric, name) for n in best.values()]) for name in names]
        sections = {content.group_titles.get(sample_set, ""): rows}
        yield Table.of("by-corruption", f"{metric_label(metric)} by corruption", columns, sections, (), "Corruption")


def _warnings(runs: Lines) -> list[tuple[str, str]]:
    """Return the benchmark of each incomplete run and of each run with invalid predictions, with a warning."""
    out = []
    for key, numbers in runs.items():
        name = plain(key.model)
        if numbers.number("missing", ""):
            out.append((key.benchmark, f"{name}: incomplete; the means are over the available rows."))
        if invalid := numbers.number("invalid_pixels", ""):
            text = f"{name}: {invalid:.0f} predicted pixels were NaN or infinite; no mean has them."
            out.append((key.benchmark, text))
    return out


def _attacks(content: Content, runs: Lines) -> list[tuple[str, Table, PageFigure | None]]:
    """Return the name, the table and the security curves of each run with attacks, and the correlation over models."""
    tables = [(plain(key.model), numbers, attack_table(numbers)) for key, numbers in runs.items()]
    out: list[tuple[str, Table, PageFigure | None]] = [
        (name, table, attack_figure(at, numbers)) for at, (name, numbers, table) in enumerate(tables) if table
    ]
    try:
        predicted = prediction_table([content.runs[key] for key in runs])
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
