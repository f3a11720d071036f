"""`robustflow leaderboard`: publish all results as a web page."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.errors import RobustFlowError, UsageError
from ..core.files import make_folder, write_bytes
from ..core.output import echo
from ..core.text import plain
from .options import refuse_unused, shared


@shared(output="Output folder; 'leaderboard' by default.")
def leaderboard(
    context: typer.Context,
    sources: Annotated[
        list[Path] | None, Argument(metavar="SOURCE", help="Folders or records of runs, and results files (CSV, JSON).")
    ] = None,
    published: Annotated[bool, Option("--published/--no-published", help="Include the paper's results.")] = True,
    add: Annotated[
        list[Path] | None,
        Option(
            help="Record or run folder to verify and add to the folder of records given as the only SOURCE. Repeatable."
        ),
    ] = None,
    supersede: Annotated[
        bool, Option("--supersede", help="With --add: remove earlier records of the same model on the same benchmark.")
    ] = False,
    **given: Any,
) -> None:
    """Build a leaderboard: a self-contained index.html, and results.csv.

    Without a source, the leaderboard shows the paper's results. Results measured on different frames form separate
    groups. A run or record that cannot be read is left out with its reason. Results files are CSV, or JSON of the
    paper's reference code (results.json); without rows, they are labelled "claimed".

    With --add the source is a folder that several people add records to. Each record is verified and copied into its
    records/ (a run's folder is packed first), and the page is rebuilt from all records.

    \b
    Examples:
      robustflow leaderboard runs/* mine.csv -o site
      robustflow leaderboard runs/mine benchmark_results/RAFT_ood/results.json
      robustflow leaderboard site --add mine.robustflow --supersede
    """
    from ..report.gallery.examples import FOLDER as EXAMPLES
    from ..report.site import render_site, whole_content
    from ..report.site.content import MOST_DETAILED
    from ..report.site.examples import embedded_slider
    from ..run.records.pack import add_records, collected, is_collection, load_any_run
    from ..stats.imported import read_imported
    from ..stats.results_file import read_results, results_csv

    output, sources = given["output"], sources or []
    if add:
        if len(sources) != 1 or output not in (None, *sources):
            raise UsageError("--add", "needs exactly one folder of records: leaderboard site --add FILE")
        output = sources[0]
        for earlier in add_records(output, add, supersede).earlier:
            then = "removed" if supersede else "is an earlier record of the same model; --supersede removes it"
            typer.echo(f"{earlier}: {then}", err=True)
    refuse_unused(context, () if add else ("supersede",), "without --add")
    sources = [path for source in sources for path in (collected(source) if is_collection(source) else [source])]
    output = output or Path("leaderboard")
    if not sources and not published:
        raise UsageError("--no-published", "nothing to show: give a run's folder or a results file, or omit it")
    files = [path for path in sources if path.suffix.lower() == ".csv"]
    imported = [path for path in sources if path.suffix.lower() == ".json"]
    runs, refused = [], []
    for path in sources:
        if path in (*files, *imported):
            continue
        try:
            runs.append(load_any_run(path))
        except RobustFlowError as error:
            refused.append(error)
            if not path.exists() or len(refused) == len(sources):
                raise
    for reason in refused:
        typer.echo(f"left out: {plain(str(reason), None)}", err=True)
    results = [(path.name, read_results(path)) for path in files]
    results.append((", ".join(path.name for path in imported), read_imported(imported)))
    content = whole_content(runs, results, published=published)
    pictured = any((run.path / EXAMPLES).is_dir() for run in runs)
    page = render_site(content, None if pictured or len(runs) > MOST_DETAILED else embedded_slider()).encode()
    make_folder(output)
    write_bytes(output / "index.html", page)
    write_bytes(output / "results.csv", results_csv(content.frame).encode())
    for run in runs:
        run.keep()
    echo(str(output / "index.html"))
