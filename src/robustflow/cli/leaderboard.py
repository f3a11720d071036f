"""`robustflow leaderboard`: all results as a page for the web."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def leaderboard(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SOURCE...]", help="Folders or records of runs, and results files (CSV)."),
    ] = None,
    published: Annotated[
        bool, typer.Option("--published/--no-published", help="The paper's results beside them.")
    ] = True,
    only_own: Annotated[
        bool, typer.Option("--only-own", help="Figures, observations and audit of the sources alone.")
    ] = False,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("leaderboard"),
) -> None:
    """Build a leaderboard: index.html, one file that opens from disk or any web server, and results.csv.

    Without a source it shows the paper's results. Results measured on other frames form groups of their own and
    are not ranked against each other. A page of more than 24 runs leaves out the example pictures, which are a third of
    its size (robustflow gallery draws them). What is computed from a run is kept in its folder for the next time.

    \b
    Examples:
      robustflow leaderboard
      robustflow leaderboard runs/* -o site
      robustflow leaderboard mine.csv --no-published
    """
    from ..analysis.results import read_results, results_csv
    from ..atomic import make_folder, write_bytes
    from ..errors import UsageError
    from ..records.load import load_run
    from ..report.site import render_site, whole_content
    from ..report.site.content import MOST_DETAILED
    from ..report.site.embedded import embedded_slider
    from ..runs.example_list import FOLDER as EXAMPLES

    if not sources and not published:
        raise UsageError("nothing to show: name a run's folder or a results file, or leave out --no-published")
    if only_own and not sources:
        raise UsageError("--only-own needs a source: name a run's folder or a results file")
    files = [path for path in sources or [] if path.suffix.lower() == ".csv"]
    runs = [load_run(path) for path in sources or [] if path not in files]
    results = [(path.name, read_results(path)) for path in files]
    content = whole_content(runs, results, published=published, only_own=only_own)
    pictured = any((run.path / EXAMPLES).is_dir() for run in runs)
    page = render_site(content, None if pictured or len(runs) > MOST_DETAILED else embedded_slider()).encode()
    make_folder(output)
    write_bytes(output / "index.html", page)
    write_bytes(output / "results.csv", results_csv(content.results).encode())
    for run in runs:
        run.keep()
    typer.echo(str(output / "index.html"))
