"""Help texts are printed in full, although rich would treat "[words]" as markup and drop them."""

from __future__ import annotations

from collections.abc import Iterator

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


def test_help_texts_contain_no_markup():
    texts = dict(_texts(typer.main.get_command(app), "robustflow"))
    assert len(texts) > 300
    assert [where for where, text in texts.items() if Text.from_markup(text).plain != text] == []
