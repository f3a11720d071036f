"""`robustflow report`: make tables and figures of runs, optionally with the published results."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import complete

if TYPE_CHECKING:
    from ..runs.run import Run

PAGE = "page"


def report(
    context: typer.Context,
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RUN",
            help="Folders or records of runs, or folders that contain them.",
        ),
    ] = None,
    published: Annotated[bool, typer.Option("--published", help="Add the paper's results.")] = False,
    only_own: Annotated[
        bool,
        typer.Option("--only-own", help="Limit figures, trends and observations to your runs."),
    ] = False,
    table: Annotated[
        str | None,
        typer.Option(
            "--table",
            "-t",
            autocompletion=complete.tables,
            help="Comma-separated: epe, cre, rcre, gopro-rcre, cost, means, uncoupled, effective, anatomy, "
            "observations, attacks, security, corruptions-and-attacks, flat-and-depth; "
            "or row, a line of LaTeX per run; by default all tables that can be made.",
        ),
    ] = None,
    format: Annotated[
        str, typer.Option("--format", "-f", help="terminal, markdown, latex, csv, html, page, or MODULE:FUNCTION.")
    ] = "terminal",
    figures: Annotated[Path | None, typer.Option("--figures", help="Folder for figures (PNG, SVG and PDF).")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write the tables to, instead of printing them.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed of the bootstrap for the intervals.")] = 0,
) -> None:
    """Make tables and figures of runs, optionally with the paper's results; `--format page` writes everything into one
    HTML file.

    \b
    Examples:
      robustflow report runs/kitti-fc_dis_* --published
      robustflow report runs/mine runs/other --table means,anatomy
      robustflow report runs/mine --table row
      robustflow report --published --table cost --format latex -o cost.tex
      robustflow report runs/mine runs/other --published --only-own --figures figures
      robustflow report runs/mine runs/other --published --format page -o report.html
    """
    from ..errors import UsageError, unknown_name
    from ..records.load import load_any_run, with_runs_inside
    from ..report.assemble import ROW, figures_of, tables_of
    from ..report.render import FORMATS
    from ..report.render.latex import only_lines
    from ..target import is_target
    from .options import names, refuse_unused
    from .tables import as_text, write_text

    if format != PAGE and not is_target(format) and format not in FORMATS.names():
        raise unknown_name("format", format, (*FORMATS.names(), PAGE))
    if not runs and not published:
        raise UsageError("nothing to report: give a run's folder, or --published")
    if only_own and not runs:
        raise UsageError("--only-own needs a run: give its folder or record")
    row_alone = names(table) == [ROW]
    if ROW in (names(table) or ()) and not (row_alone and format in ("terminal", "latex")):
        raise UsageError(f"--table {ROW} prints a line of LaTeX per run: omit other tables and formats")
    loaded = [load_any_run(run) for run in with_runs_inside(runs or [])]
    if format == PAGE:
        refuse_unused(context, {"seed"}, "with --format page")
        text = _page(loaded, published, only_own, table)
    else:
        tables = tables_of(loaded, published=published, wanted=names(table), seed=seed, only_own=only_own)
        texts = map(only_lines, tables) if row_alone else ()
        text = "".join(texts) or "\n".join(as_text(one, format, output) for one in tables)
    write_text(text, output)
    if figures is not None:
        from ..report.figures import write_figures

        for path in write_figures(figures_of(loaded, published=published and not only_own), figures):
            typer.echo(str(path), err=output is None)


def _page(runs: "list[Run]", published: bool, only_own: bool, table: str | None) -> str:
    from ..errors import UsageError
    from ..report.site import render_site, whole_content

    if table is not None:
        raise UsageError("a page always has all tables; omit --table, or choose another --format")
    return render_site(whole_content(runs, published=published, only_own=only_own))
