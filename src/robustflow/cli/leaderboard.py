"""`robustflow leaderboard`: all results as a page for the web."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def leaderboard(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SOURCE...]", help="Folders or records of runs, and results files (CSV, JSON)."),
    ] = None,
    published: Annotated[
        bool, typer.Option("--published/--no-published", help="The paper's results beside them.")
    ] = True,
    only_own: Annotated[
        bool, typer.Option("--only-own", help="Figures, observations and audit only of the sources.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write; leaderboard by default.")
    ] = None,
    add: Annotated[
        list[Path] | None,
        typer.Option(
            "--add",
            help="A record, or a run's folder, to verify and copy into the one SOURCE, a folder of records. "
            "Repeatable.",
        ),
    ] = None,
    supersede: Annotated[
        bool,
        typer.Option("--supersede", help="With --add: remove earlier records of the same model on the same benchmark."),
    ] = False,
) -> None:
    """Build a leaderboard: index.html, one file that opens from disk or any web server, and results.csv.

    Without a source it shows the paper's results. Results measured on other frames form separate groups and
    are not ranked against each other. A page of more than 24 runs leaves out the example pictures, which are a third of
    its size (robustflow gallery draws them). What is computed from a run is kept in its folder for the next time.

    Results files are CSV, or JSON as the paper's reference code (results.json) and FlowBench (metrics_DATASET.json)
    write it: means without rows, which form separate groups and say that nothing in them can be verified.

    With --add the source is a folder that several people add records to: each is verified and copied into its records/
    (of a run's folder the record is made first), and the page in it is built again from all that are there. A folder of
    records may be a source without --add too.

    \b
    Examples:
      robustflow leaderboard
      robustflow leaderboard runs/* -o site
      robustflow leaderboard mine.csv --no-published
      robustflow leaderboard runs/mine benchmark_results/RAFT_ood/results.json
      robustflow leaderboard site --add mine.robustflow
      robustflow leaderboard site --add runs/kitti-fc_mine_1a2b3c4d --supersede
      robustflow leaderboard site -o site
    """
    from ..analysis.imported import read_imported
    from ..analysis.results_file import read_results, results_csv
    from ..atomic import make_folder, write_bytes
    from ..errors import UsageError
    from ..records.collection import add_records, collected, is_collection
    from ..records.load import load_any_run
    from ..report.site import render_site, whole_content
    from ..report.site.content import MOST_DETAILED
    from ..report.site.embedded import embedded_slider
    from ..runs.example_list import FOLDER as EXAMPLES

    if add:
        if len(sources or []) != 1 or output not in (None, *(sources or [])):
            raise UsageError(
                "--add takes one folder of records, which the page is written to: leaderboard site --add FILE"
            )
        output = (sources or [])[0]
        added = add_records(output, add, supersede)
        for earlier in added.earlier:
            then = "removed" if supersede else "is an earlier record of the same model; --supersede removes it"
            typer.echo(f"{earlier}: {then}", err=True)
    elif supersede:
        raise UsageError("--supersede is for --add, which it removes earlier records for; leave it out")
    sources = [path for source in sources or [] for path in (collected(source) if is_collection(source) else [source])]
    output = output or Path("leaderboard")
    if not sources and not published:
        raise UsageError("nothing to show: name a run's folder or a results file, or leave out --no-published")
    if only_own and not sources:
        raise UsageError("--only-own needs a source: name a run's folder or a results file")
    files = [path for path in sources if path.suffix.lower() == ".csv"]
    imported = [path for path in sources if path.suffix.lower() == ".json"]
    runs = [load_any_run(path) for path in sources if path not in (*files, *imported)]
    results = [*((path.name, read_results(path)) for path in files), ("imported", read_imported(imported))]
    content = whole_content(runs, results, published=published, only_own=only_own)
    pictured = any((run.path / EXAMPLES).is_dir() for run in runs)
    page = render_site(content, None if pictured or len(runs) > MOST_DETAILED else embedded_slider()).encode()
    make_folder(output)
    write_bytes(output / "index.html", page)
    write_bytes(output / "results.csv", results_csv(content.lines).encode())
    for run in runs:
        run.keep()
    typer.echo(str(output / "index.html"))
