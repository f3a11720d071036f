"""`robustflow reproduce audit`: check results for internal consistency."""

from pathlib import Path
from typing import Annotated

import typer

FOUND = 3
"""Exit code for inconsistent results; 1 and 2 are errors, as for every command."""


def audit(
    source: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", help="A results file (CSV); the paper's tables by default."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """List numbers that contradict the others by more than rounding, each with its printed and its recomputed value.

    Recomputes CRE from EPE, averages, CREr, ranks and highlighted best values; detects swapped or shifted rows.
    Exit codes: 0 if everything is consistent, 3 if not, 1 if the source cannot be read.

    \b
    Examples:
      robustflow reproduce audit
      robustflow reproduce audit results.csv --json
    """
    from ..analysis.audit import AUDIT_CHECKS, audit_published, audit_results
    from ..analysis.results_file import read_results
    from ..text import plain

    audit = audit_published() if source is None else audit_results(read_results(source), str(source))
    if as_json:
        typer.echo(audit.model_dump_json(indent=2))
    else:
        for check, count in audit.checked.items():
            findings = [finding for finding in audit.findings if finding.check == check]
            typer.echo(
                f"{AUDIT_CHECKS[check]}: {len(findings)} of {count} are inconsistent"
                if findings
                else f"{AUDIT_CHECKS[check]}: {count} fit"
            )
            for finding in findings:
                where = f"{finding.source}: " if finding.source else ""
                typer.echo(f"  {plain(where + finding.message, 400)}")
        if not audit.checked:
            typer.echo("no number can be derived from the others, so nothing was checked")
        typer.echo(f"{plain(audit.audited, 200)}: {len(audit.findings)} finding{'s' * (len(audit.findings) != 1)}")
    if not audit.fits:
        raise typer.Exit(FOUND)
