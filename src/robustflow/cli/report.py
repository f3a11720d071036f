"""`robustflow report`: print runs, make tables and figures of them, and draw their example pictures."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import DataError, UsageError, unknown_name
from . import complete
from .options import (
    Data,
    DataOptions,
    ModelOptions,
    OwnCorruptions,
    data_options,
    keyword_options,
    names,
    refuse_unused,
    use_own_corruptions,
)

if TYPE_CHECKING:
    from ..run.run import Run
    from ..run.source import RunSource

PAGE = "page"
_PRINTING = ("metric", "as_json")
_TABLES = ("published", "only_own", "table", "format", "figures", "seed")
_DRAWING = ("corruption", "severity", "data", "data_option", "model", "option", "own_corruption")


def report(
    context: typer.Context,
    runs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="RUN", help="Folders or records of runs, or folders that contain them."),
    ] = None,
    metric: Annotated[
        str | None,
        typer.Option(
            "--metric",
            help="Print only epe, cre, crer, rcre, rcre_all, fl, px1, px3, px5, wauc, photometric, coverage or spread; "
            "less dependent on accuracy: log_ratio, median_log_ratio, median_cre, fl_increase.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print name, benchmark, folder and summary as JSON.")] = False,
    published: Annotated[bool, typer.Option("--published", help="Add the paper's results.")] = False,
    only_own: Annotated[
        bool,
        typer.Option("--only-own", help="Limit figures and trends to your runs."),
    ] = False,
    table: Annotated[
        str | None,
        typer.Option(
            "--table",
            "-t",
            autocompletion=complete.tables,
            help="Comma-separated: epe, cre, rcre, gopro-rcre, cost, means, uncoupled, effective, anatomy, "
            "attacks, security, corruptions-and-attacks, flat-and-depth; "
            "row, a line of LaTeX per run; or all, every table that can be made.",
        ),
    ] = None,
    format: Annotated[
        str, typer.Option("--format", "-f", help="terminal, markdown, latex, csv, html, page, or MODULE:FUNCTION.")
    ] = "terminal",
    figures: Annotated[Path | None, typer.Option("--figures", help="Folder for figures (PNG, SVG and PDF).")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File for the tables, the page or the picture of --sample.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed of the bootstrap for the intervals.")] = 0,
    examples: Annotated[
        bool, typer.Option("--examples", help="Draw the worst and the median sample into RUN/examples and the page.")
    ] = False,
    sample: Annotated[str | None, typer.Option("--sample", help="Draw only this sample, as a PNG file.")] = None,
    corruption: Annotated[
        str | None,
        typer.Option("--corruption", "--corruptions", "-c", help="With --sample: name of the corruption."),
    ] = None,
    severity: Annotated[int | None, typer.Option("--severity", "--severities", "-s", help="With --sample.")] = None,
    data: Data = None,
    data_option: DataOptions = None,
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="Model of the run, if the run does not record it.")
    ] = None,
    option: ModelOptions = None,
    own_corruption: OwnCorruptions = None,
) -> None:
    """Print runs and update their summaries and pages; or make tables and figures, optionally with the paper's results.

    With --format page, everything is written into one HTML file.

    With --examples or --sample, draw frames, corrupted frames, flows and error maps of one run. The model and the data
    are read from where they were during the run; if they have moved, use --data, -D and -O. If the model is your own
    code (module:Attribute) or a file, give it with --model or -O checkpoint=FILE: for safety, nothing is loaded just
    because it is named in a run's folder.

    \b
    Examples:
      robustflow report runs/demo_dis_1a2b3c4d --metric rcre
      robustflow report runs/kitti-fc_dis_* --published
      robustflow report runs/mine runs/other --table means,anatomy
      robustflow report runs/mine --table row
      robustflow report --published --table cost --format latex -o cost.tex
      robustflow report runs/mine runs/other --published --only-own --figures figures
      robustflow report runs/mine runs/other --published --format page -o report.html
      robustflow report RUN --examples --data /mnt/kitti
      robustflow report RUN --sample 000010_10 --corruption fog --severity 3 -o fog.png
    """
    from ..core.plugins import is_target
    from ..models import ModelSpec
    from ..report.assemble import ROW, figures_of, tables_of
    from ..report.render import FORMATS
    from ..report.render.latex import only_lines
    from ..run.records.pack import load_any_run, with_runs_inside
    from ..run.run import Run
    from ..run.source import RunSource
    from .tables import as_text, write_text

    if examples or sample is not None:
        refuse_unused(context, (*_PRINTING, *_TABLES), "with --examples or --sample")
        if not runs or len(runs) > 1:
            raise UsageError("--examples and --sample draw pictures of one run: give its folder")
        if examples:
            refuse_unused(context, ("sample", "corruption", "severity", "output"), "with --examples")
        run = Run(runs[0])
        use_own_corruptions(own_corruption)
        before = RunSource.read(run.path)
        options = keyword_options(option)
        spec = before.model_to_reuse(dict(options)) if model is None else ModelSpec(model, options)
        source = RunSource(spec, data or before.data, before.data_options | data_options(data_option))
        if sample is None:
            _draw_examples(run, source)
        elif corruption is None or severity is None:
            raise UsageError("a single picture needs --sample KEY, --corruption NAME and --severity N")
        else:
            _draw_sample(run, source, (sample, corruption, severity), output)
        return
    refuse_unused(context, _DRAWING, "without --examples or --sample")
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
    if not (published or table or figures or output or format != "terminal"):
        refuse_unused(context, ("seed",), "without --table")
        _print_runs(loaded, metric, as_json)
        return
    refuse_unused(context, _PRINTING, "with tables and figures")
    if format == PAGE:
        refuse_unused(context, {"seed"}, "with --format page")
        text = _page(loaded, published, only_own, table)
    else:
        wanted = None if table == "all" else names(table)
        tables = tables_of(loaded, published=published, wanted=wanted, seed=seed, only_own=only_own)
        texts = map(only_lines, tables) if row_alone else ()
        text = "".join(texts) or "\n".join(as_text(one, format, output) for one in tables)
    write_text(text, output)
    if figures is not None:
        from ..report.figures import write_figures

        for path in write_figures(figures_of(loaded, published=published and not only_own), figures):
            typer.echo(str(path), err=output is None)


def _print_runs(runs: "Sequence[Run]", metric: str | None, as_json: bool) -> None:
    from ..report.site.page import write_report
    from .tables import as_json_text, print_result, print_results

    current = set()
    for run in runs:
        if run.record:
            continue
        try:
            run.write_means()
            write_report(run)
            current.add(run)
        except DataError as error:
            warnings.warn(f"the summary and the report were not updated: {error}", stacklevel=1)
    if as_json:
        typer.echo(as_json_text(runs))
    elif len(runs) > 1 and metric is None:
        print_results(runs)
    else:
        for run in runs:
            print_result(run, metric or "all", report=run in current)


def _draw_examples(run: "Run", source: "RunSource") -> None:
    from ..report.site.page import write_report
    from ..run.example_cells import FOLDER
    from ..run.examples import write_examples
    from ..run.setup import restore_setup
    from ..run.store import RunFolder

    setup, store = restore_setup(run, source), RunFolder(run.path)
    store.lock()
    try:
        if write_examples(run, setup):
            write_report(run)
    finally:
        store.unlock()
    typer.echo(str(run.path / FOLDER))


def _draw_sample(run: "Run", source: "RunSource", cell: tuple[str, str, int], output: Path | None) -> None:
    from ..core.files import write_bytes
    from ..run.examples import draw_example
    from ..run.setup import restore_setup

    sample, corruption, severity = cell
    target = output or Path(f"{sample.replace('/', '_')}_{corruption}_{severity}.png")
    write_bytes(target, draw_example(run, restore_setup(run, source), *cell))
    typer.echo(str(target))


def _page(runs: "list[Run]", published: bool, only_own: bool, table: str | None) -> str:
    from ..report.site import render_site, whole_content

    if table is not None:
        raise UsageError("a page always has all tables; omit --table, or choose another --format")
    return render_site(whole_content(runs, published=published, only_own=only_own))
