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
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("leaderboard"),
) -> None:
    """Build a leaderboard: index.html, one file that opens from disk or any web server, and results.csv.

    Without a source it shows the paper's results. Results measured on other frames stand in groups of their own and
    are not ranked against each other.

    \b
    Examples:
      robustflow leaderboard
      robustflow leaderboard runs/* -o site
      robustflow leaderboard mine.csv --no-published
    """
    from ..atomic import make_folder, write_bytes
    from ..errors import UsageError
    from ..report.load import load_run
    from ..report.results import read_results
    from ..report.site import render_site, whole_content
    from ..report.site.results_file import results_csv

    if not sources and not published:
        raise UsageError("nothing to show: name a run's folder or a results file, or leave out --no-published")
    files = [path for path in sources or [] if path.suffix.lower() == ".csv"]
    runs = [load_run(path) for path in sources or [] if path not in files]
    content = whole_content(runs, [(path.name, read_results(path)) for path in files], published=published)
    page = render_site(content).encode()
    make_folder(output)
    write_bytes(output / "index.html", page)
    write_bytes(output / "results.csv", results_csv(content.results).encode())
    typer.echo(str(output / "index.html"))
