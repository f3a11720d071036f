"""`robustflow report`: print runs, make tables and figures of them, and draw their example pictures."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..core.errors import DataError, UsageError, unknown_name
from ..core.files import write_bytes
from ..core.output import echo
from ..core.plugins import is_target
from . import complete
from .options import DATASET, data_options, keyword_options, names, refuse_unused, shared

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..run.run import Run

PAGE = "page"
_PRINTING = ("metric", "as_json")
_TABLES = ("published", "table", "format", "figures")
_DRAWING = ("corruption", "severity", "model", "option", "own_corruption", *DATASET)


@shared(
    *("data", "data_options", "option", "own_corruption"),
    model="Model of the run, if the run does not record it.",
    format="terminal, markdown, latex, csv, html, page, or MODULE:FUNCTION.",
    output="File for the tables, the page or the picture of --sample.",
    as_json="Print name, benchmark, folder and summary as JSON.",
)
def report(
    context: typer.Context,
    runs: Annotated[list[Path] | None, Argument(metavar="RUN", help="Runs, records, or folders of them.")] = None,
    metric: Annotated[
        str | None,
        Option(
            help="Print only, or also show on the page: epe, cre, crer, rcre, rcre_all, fl, px1, px3, px5, wauc, "
            "photometric, coverage or spread; "
            "less dependent on accuracy: log_ratio, median_log_ratio, median_cre, fl_increase.",
        ),
    ] = None,
    published: Annotated[bool, Option("--published", help="Add the paper's results.")] = False,
    table: Annotated[
        str | None,
        Option(
            "--table",
            "-t",
            autocompletion=complete.tables,
            help="Comma-separated: epe, cre, rcre, gopro-rcre, cost, means, uncoupled, effective, "
            "attacks, security, corruptions-and-attacks; "
            "row, a line of LaTeX per run; or all, every table that can be made.",
        ),
    ] = None,
    figures: Annotated[Path | None, Option(help="Folder for figures (PNG, SVG and PDF).")] = None,
    examples: Annotated[bool, Option("--examples", help="Draw the worst and the median sample of a run.")] = False,
    sample: Annotated[str | None, Option(help="Draw only this sample, as a PNG file.")] = None,
    corruption: Annotated[str | None, Option("--corruption", "--corruptions", "-c", help="With --sample.")] = None,
    severity: Annotated[int | None, Option("--severity", "--severities", "-s", help="With --sample.")] = None,
    **given: Any,
) -> None:
    """Print runs and update their pages; or make tables, figures or example pictures of them.

    With --format page, everything is written into one HTML file. With --examples or --sample, frames, corrupted frames,
    flows and error maps of one run are drawn; the model and the data are read from where they were during the run,
    unless -m, -O, --data or -D are given. A model that is code or a file must be given: nothing is loaded just because
    it is named in a run's folder.

    \b
    Examples:
      robustflow report runs/demo_dis_1a2b3c4d --metric rcre
      robustflow report runs/mine runs/other --table means,effective
      robustflow report --published --table cost --format latex -o cost.tex
      robustflow report runs/mine runs/other --published --format page -o report.html
      robustflow report RUN --examples --data /mnt/kitti
      robustflow report RUN --sample 000010_10 --corruption fog --severity 3 -o fog.png
    """
    from ..report.render import FORMATS
    from ..report.render.latex import only_lines
    from ..report.tables import ROW, figures_of, tables_of
    from ..run.records.pack import load_any_run, with_runs_inside
    from .tables import as_text, check_metric, write_text

    format, output = given["format"], given["output"]
    if examples or sample is not None:
        refuse_unused(context, (*_PRINTING, *_TABLES), "with --examples or --sample")
        if examples:
            refuse_unused(context, ("sample", "corruption", "severity", "output"), "with --examples")
        if not runs or len(runs) > 1:
            raise UsageError("RUN", "--examples and --sample draw pictures of one run: give its folder")
        _draw(runs[0], (sample, corruption, severity), given)
        return
    refuse_unused(context, _DRAWING, "without --examples or --sample")
    if format != PAGE and not is_target(format) and format not in FORMATS.names():
        raise unknown_name("format", format, (*FORMATS.names(), PAGE))
    if not runs and not published:
        raise UsageError("RUN", "nothing to report: give a run's folder, or --published")
    wanted = None if table == "all" else names(table)
    if ROW in (wanted or ()) and not (wanted == [ROW] and format in ("terminal", "latex")):
        raise UsageError("--table", f"{ROW} prints a line of LaTeX per run: omit other tables and formats")
    if format == PAGE:
        refuse_unused(context, {"table"}, "with --format page, which has all tables")
    if metric is not None:
        check_metric(metric)
    loaded = [load_any_run(run) for run in with_runs_inside(runs or [])]
    if not (published or table or figures or output or format != "terminal"):
        _print_runs(loaded, metric, given["as_json"])
        return
    refuse_unused(context, ("as_json",) if format == PAGE else _PRINTING, "with tables and figures")
    if format == PAGE:
        from ..report.site import render_site, whole_content

        text = render_site(whole_content(loaded, published=published, asked=metric or ""))
    else:
        tables = tables_of(loaded, published=published, wanted=wanted)
        text = "\n".join(as_text(made_table, format, output) for made_table in tables)
        if wanted == [ROW]:
            text = "".join(map(only_lines, tables))
    write_text(text, output)
    if figures is not None:
        from ..report.figures import write_figures

        for path in write_figures(figures_of(loaded, published=published), figures):
            typer.echo(str(path), err=output is None)


def _print_runs(runs: "Sequence[Run]", metric: str | None, as_json: bool) -> None:
    from ..report.site.page import write_report
    from .tables import as_json_text, print_result, print_results

    current, asked = set(), metric or ""
    for run in runs:
        if run.record:
            continue
        try:
            run.write_means()
            write_report(run, asked=asked)
            current.add(run)
        except DataError as error:
            warnings.warn(f"the summary and the report were not updated: {error}", stacklevel=1)
    if as_json:
        echo(as_json_text(runs))
    elif len(runs) > 1 and metric is None:
        print_results(runs)
    else:
        for run in runs:
            print_result(run, metric or "all", report=run in current)


def _draw(folder: Path, cell: tuple[str | None, str | None, int | None], given: dict[str, Any]) -> None:
    """Draw the examples of a run, or only one of its cells: (sample, corruption, severity)."""
    from ..models import ModelRef
    from ..pictures.examples import draw_example, write_examples
    from ..report.gallery.examples import FOLDER, are_current
    from ..report.site.page import write_report
    from ..run.repeat import restore_plan
    from ..run.run import Run
    from ..run.source import RunSource
    from ..run.store import RunFolder

    run, options, (sample, corruption, severity) = Run(folder), keyword_options(given["option"]), cell
    if sample is not None and (corruption is None or severity is None):
        raise UsageError("--sample", "a single picture needs --sample KEY, --corruption NAME and --severity N")
    before = RunSource.read(run.path)
    ref = before.model_to_reuse(dict(options)) if given["model"] is None else ModelRef.parse(given["model"], options)
    source = RunSource(ref, given["data"] or before.data, before.data_options | data_options(given))
    plan = restore_plan(run, source)
    if sample is not None and corruption is not None and severity is not None:
        target = given["output"] or Path(f"{sample.replace('/', '_')}_{corruption}_{severity}.png")
        write_bytes(target, draw_example(run, plan, sample, corruption, severity))
        echo(str(target))
        return
    store = RunFolder(run.path)
    store.lock()
    try:
        if not are_current(run):
            for _ in write_examples(run, plan):
                pass
            write_report(run)
    finally:
        store.unlock()
    echo(str(run.path / FOLDER))
