"""Help texts are printed in full, although rich would treat "[words]" as markup and drop them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import typer
from rich.text import Text

from robustflow.cli.main import app


def _texts(command, path: str) -> Iterator[tuple[str, str]]:
    if command.help:
        yield path, command.help.replace("\b", "")
    for parameter in command.params:
        if getattr(parameter, "help", None):
            yield f"{path} {parameter.name}", parameter.help
    for name, child in getattr(command, "commands", {}).items():
        yield from _texts(child, f"{path} {name}")


_TEXTS = dict(_texts(typer.main.get_command(app), "robustflow"))


@pytest.mark.parametrize("where", _TEXTS)
def test_nothing_is_taken_for_markup(where):
    assert Text.from_markup(_TEXTS[where]).plain == _TEXTS[where]
