"""Tables written out: one file per format.

Names in a table may come from anyone's file. Every renderer first takes out what no format should receive
(`robustflow.text.plain`), then escapes what its own gives a meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from ...errors import unknown_name
from ..table import Table

FORMATS = ("terminal", "markdown", "latex", "csv", "html")


def render(table: Table, format: str) -> str:
    """The table as text, ending with a line break.

    Args:
        table: from `build_table`.
        format: "terminal" (120 columns wide, no colour), "markdown", "latex" (booktabs), "csv" or "html" (a fragment).

    Raises:
        UsageError: unknown format.

    >>> from robustflow.report.table import Cell, Column, Line, Section, Table
    >>> line = Line("A|B", (Cell("1.00", best=True),))
    >>> table = Table("x", "Errors", (Column("Clean"),), (Section("OOD", (line,)),))
    >>> print(render(table, "markdown").splitlines()[5])
    | A\\|B | **1.00** |
    """
    if format not in FORMATS:
        raise unknown_name("format", format, FORMATS)
    renderer: Callable[[Table], str] = import_module(f"{__name__}.{format}").render
    return renderer(table)
