"""`robustflow verify`: whether records hold together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import DataOptions, keyword_options

if TYPE_CHECKING:
    from ..records.read import Reader
    from ..records.verify import Verification


def verify(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Records that 'robustflow pack' wrote.")],
    data: Annotated[
        Path | None,
        typer.Option("--data", "-d", help="Your own copy of the data: corrupted frames are made again and compared."),
    ] = None,
    data_option: DataOptions = None,
    check_frames: Annotated[
        int | None, typer.Option("--check-frames", metavar="N", help="Rows to compare with the data [20].")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Which rows these are; drawn anew each time by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the checks as JSON.")] = False,
) -> None:
    """Check records without the model or the data: the file, hashes, what was planned, rows, and every mean anew.

    With the data, random rows are made again up to the model: the frames it was given, to the byte, and what the
    ground truth decides. Exit code 0: every check of every file holds; 1: one does not.

    \b
    Examples:
      robustflow verify submissions/*.robustflow
      robustflow verify mine.robustflow --data ~/kitti --check-frames 100
    """
    import json

    from ..records.verify import verify as verify_file

    def frames(reader: Reader) -> str:
        from ..runner.recheck import recheck

        identity = reader.raw_manifest["identity"]
        options = dict(keyword_options(data_option))
        count = 20 if check_frames is None else check_frames
        return recheck(identity, reader.frame, data, options=options, count=count, seed=seed)

    wanted = data is not None or check_frames is not None
    found = [verify_file(path, frames=frames if wanted else None) for path in files]
    if as_json:
        typer.echo(json.dumps([{"ok": one.ok, **one.model_dump()} for one in found], indent=2))
    else:
        for one in found:
            _print(one)
    if not all(one.ok for one in found):
        raise typer.Exit(1)


def _print(found: Verification) -> None:
    from ..records.verify import CHECKS
    from ..text import plain

    typer.echo(plain(found.file, 200))
    for check in found.checks:
        about = f"{CHECKS[check.name]}{f': {check.says}' if check.says else ''}"
        typer.echo(f"  {check.status:11s}  {check.name:12s}  {about}")
    said = found.facts.model_dump(include={"author", "link", "description"}) if found.facts else {}
    for name, text in said.items():
        if text:
            typer.echo(f"  {name}: {plain(text, None)}")
    verdict = "verified" if found.ok else "not verified"
    typer.echo(f"  {verdict}{f', SHA-256 {found.sha256}' if found.sha256 else ''}")
