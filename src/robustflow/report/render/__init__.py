"""Renderers of tables: one module per built-in format, and user-defined formats.

Names in a table may come from untrusted files. Every renderer first removes control characters
(`robustflow.core.text.plain`), then escapes the special characters of its format.
"""

from __future__ import annotations

from collections.abc import Callable

from ...core.errors import RobustFlowError, UsageError
from ...core.plugins import Registry, import_target, is_target
from ..table import Table

Renderer = Callable[[Table], str]

FORMATS: Registry[Renderer] = Registry("format", entry_point_group="robustflow.table_formats")
for _name in ("terminal", "markdown", "latex", "csv", "html"):
    FORMATS.add(_name, f"{__name__}.{_name}:render")


def render(table: Table, format: str) -> str:
    """Render a table as text that ends with a line break."""
    write = renderer(format)
    try:
        text = write(table)
    except RobustFlowError:
        raise
    except Exception as error:
        if not is_target(format):
            raise
        raise UsageError(format, f"raised {type(error).__name__} for the table '{table.name}': {error}") from error
    if not isinstance(text, str):
        raise UsageError(format, f"returned {type(text).__name__} for the table '{table.name}', not text")
    return text


def renderer(format: str) -> Renderer:
    """Return the function that renders a table in a format.

    >>> renderer("csv").__module__
    'robustflow.report.render.csv'
    """
    if not is_target(format):
        return FORMATS.get(format)
    function = import_target(format, "format")
    if not callable(function):
        raise UsageError(f"{format} is not a function, so it cannot render a table")
    return function
