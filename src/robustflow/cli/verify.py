"""`robustflow verify`: whether records hold together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..report.record.verify import Verification


def verify(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Records that 'robustflow pack' wrote.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the checks as JSON.")] = False,
) -> None:
    """Check records without the model or the data: the file, hashes, what was planned, rows, and every mean anew.

    Exit code 0: every check of every file holds; 1: one does not.

    \b
    Example:
      robustflow verify submissions/*.robustflow
    """
    import json

    from ..report.record.verify import verify as verify_file

    found = [verify_file(path) for path in files]
    if as_json:
        typer.echo(json.dumps([{"ok": one.ok, **one.model_dump()} for one in found], indent=2))
    else:
        for one in found:
            _print(one)
    if not all(one.ok for one in found):
        raise typer.Exit(1)


def _print(found: Verification) -> None:
    from ..report.record.verify import CHECKS
    from ..report.text import plain

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
