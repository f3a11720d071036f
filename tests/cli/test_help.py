"""Help texts are printed in full, although rich would treat "[words]" as markup and drop them, and show examples."""

from __future__ import annotations

from collections.abc import Iterator

import typer
from rich.text import Text
from typer.testing import CliRunner

from robustflow.cli.main import app


def _commands(command, path: str) -> Iterator[tuple[str, object]]:
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from _commands(child, f"{path} {name}")


COMMANDS = dict(_commands(typer.main.get_command(app), "robustflow"))


def test_help_texts_contain_no_markup():
    texts = {path: command.help.replace("\b", "") for path, command in COMMANDS.items() if command.help}
    for path, command in COMMANDS.items():
        texts |= {f"{path} {one.name}": one.help for one in command.params if getattr(one, "help", None)}
    assert len(texts) > 300
    assert [where for where, text in texts.items() if Text.from_markup(text).plain != text] == []


def test_help_of_every_command_shows_an_example_of_it():
    for path, command in COMMANDS.items():
        if not hasattr(command, "commands"):
            written = path.replace("reproduce table", "reproduce")  # "table" may be omitted
            words = CliRunner().invoke(app, [*path.split()[1:], "--help"]).output.replace("│", "").split()
            shown = " ".join(words)
            assert written in shown.partition("Example")[2], path
