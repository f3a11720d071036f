"""`robustflow leaderboard`: publish all results as a web page."""

from pathlib import Path
from typing import Annotated

import typer


def leaderboard(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SOURCE", help="Folders or records of runs, and results files (CSV, JSON)."),
    ] = None,
    published: Annotated[bool, typer.Option("--published/--no-published", help="Include the paper's results.")] = True,
    only_own: Annotated[bool, typer.Option("--only-own", help="Limit figures and audit to the sources.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Output folder; 'leaderboard' by default.")
    ] = None,
    add: Annotated[
        list[Path] | None,
        typer.Option(
            "--add",
            help="Record or run folder to verify and add to the folder of records given as the only SOURCE. "
            "Repeatable.",
        ),
    ] = None,
    supersede: Annotated[
        bool,
        typer.Option("--supersede", help="With --add: remove earlier records of the same model on the same benchmark."),
    ] = False,
) -> None:
    """Build a leaderboard: a self-contained index.html, and results.csv.

    Without a source, the leaderboard shows the paper's results. Results measured on different frames form separate
    groups and are not ranked against each other. A run or record that cannot be read, such as one of an earlier
    version, is left out with its reason. Pages with more than 24 runs omit the example pictures, which make up a third
    of the file size (robustflow gallery draws them). Values computed from a run are cached in its folder.

    Results files are CSV, or JSON written by the paper's reference code (results.json) or FlowBench
    (metrics_DATASET.json). They contain means without rows, so they form separate groups, labelled "claimed", below all
    others.

    With --add the source is a folder that several people add records to. Each record is verified and copied into its
    records/ (a run's folder is packed first), and the page is rebuilt from all records. Without --add, a folder of
    records can be a source, too.

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
    from ..core.errors import RobustFlowError, UsageError
    from ..core.files import make_folder, write_bytes
    from ..core.text import plain
    from ..report.site import render_site, whole_content
    from ..report.site.content import MOST_DETAILED
    from ..report.site.examples import embedded_slider
    from ..run.example_cells import FOLDER as EXAMPLES
    from ..run.records.collection import add_records, collected, is_collection
    from ..run.records.pack import load_any_run
    from ..stats.imported import read_imported
    from ..stats.results_file import read_results, results_csv

    if add:
        if len(sources or []) != 1 or output not in (None, *(sources or [])):
            raise UsageError("--add needs exactly one folder of records as the SOURCE: leaderboard site --add FILE")
        output = (sources or [])[0]
        added = add_records(output, add, supersede)
        for earlier in added.earlier:
            then = "removed" if supersede else "is an earlier record of the same model; --supersede removes it"
            typer.echo(f"{earlier}: {then}", err=True)
    elif supersede:
        raise UsageError("--supersede requires --add; leave it out")
    sources = [path for source in sources or [] for path in (collected(source) if is_collection(source) else [source])]
    output = output or Path("leaderboard")
    if not sources and not published:
        raise UsageError("nothing to show: give a run's folder or a results file, or omit --no-published")
    if only_own and not sources:
        raise UsageError("--only-own needs a source: give a run's folder or a results file")
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
    content = whole_content(runs, results, published=published, only_own=only_own)
    pictured = any((run.path / EXAMPLES).is_dir() for run in runs)
    page = render_site(content, None if pictured or len(runs) > MOST_DETAILED else embedded_slider()).encode()
    make_folder(output)
    write_bytes(output / "index.html", page)
    write_bytes(output / "results.csv", results_csv(content.lines).encode())
    for run in runs:
        run.keep()
    typer.echo(str(output / "index.html"))
