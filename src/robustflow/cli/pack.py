"""`robustflow pack`: pack a run into one file that can be shared and verified."""

from pathlib import Path
from typing import Annotated

import typer


def pack(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Output file, NAME.robustflow; named after the folder by default."),
    ] = None,
    author: Annotated[str, typer.Option(help="Submitter of the record.")] = "",
    link: Annotated[str, typer.Option(help="URL with more information: https://...")] = "",
    description: Annotated[str, typer.Option(help="Description in one or two sentences, plain text.")] = "",
    partial: Annotated[
        bool, typer.Option("--partial", help="Pack an unfinished run; the record is marked as such.")
    ] = False,
    keep_paths: Annotated[
        bool, typer.Option("--keep-paths", help="Allow texts that contain paths on this machine.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file that is not a record of this run.")
    ] = False,
) -> None:
    """Pack a run into one file that another machine can verify and add to its leaderboard.

    The record contains the manifest, rows and means of the run, but no images, command lines, paths or machine names.
    Packing is deterministic.

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
