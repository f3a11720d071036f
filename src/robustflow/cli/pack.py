"""`robustflow pack`: a run as one file, to be sent and checked elsewhere."""

from pathlib import Path
from typing import Annotated

import typer


def pack(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The file, NAME.robustflow; by default with the folder's name."),
    ] = None,
    author: Annotated[str, typer.Option(help="Who submits the record.")] = "",
    link: Annotated[str, typer.Option(help="Where to read more: https://...")] = "",
    description: Annotated[str, typer.Option(help="A sentence or two, plain text.")] = "",
    partial: Annotated[
        bool, typer.Option("--partial", help="Pack an unfinished run; the record is marked as such.")
    ] = False,
    keep_paths: Annotated[
        bool, typer.Option("--keep-paths", help="Pack texts even if they contain paths of this machine.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file that is not a record of this run.")
    ] = False,
) -> None:
    """Pack a run into one file that another machine can verify and add to its leaderboard.

    It holds what ran, the rows and the means, but no image, command line, path or name of this machine. The same run
    always gives the same bytes.

    \b
    Examples:
      robustflow pack runs/kitti-fc_mine_1a2b3c4d
      robustflow pack runs/mine -o mine.robustflow --author "A. Author" --link https://example.org/mine
    """
    from ..records.pack import pack as pack_run
    from ..runs.run import Run
    from ..text import plain

    path = pack_run(
        Run(run),
        output,
        author=author,
        link=link,
        description=description,
        partial=partial,
        keep_paths=keep_paths,
        overwrite=overwrite,
    )
    typer.echo(plain(str(path), None))
