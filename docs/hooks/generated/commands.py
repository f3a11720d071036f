"""A page for each command with its description, arguments and options, as declared by the command line."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from robustflow.cli.main import app

FOLDER = "reference/cli"
_COMPLETION = {
    "install_completion": "Install completion for the current shell (bash, zsh, fish, PowerShell).",
    "show_completion": "Print the completion script, to copy it or to change how it is installed.",
}


def files() -> dict[str, str]:
    """All command pages, and the page that lists them."""
    pages = {f"{FOLDER}/{slug(path)}.md": page(path, command) for path, command in commands()}
    return {**pages, f"{FOLDER}/index.md": index()}


def navigation() -> list[Any]:
    """The list first, then the commands in the order of `robustflow --help`."""
    return [f"{FOLDER}/index.md", *({path: f"{FOLDER}/{slug(path)}.md"} for path, _ in commands())]


def commands() -> Iterator[tuple[str, Any]]:
    """Pairs such as ("prepare gopro-fc", the command), without the groups themselves."""
    yield from _below(typer.main.get_command(app), "")


def _below(group: Any, path: str) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        whole = f"{path} {name}".strip()
        if hasattr(command, "commands"):
            yield from _below(command, whole)
        else:
            yield whole, command


def slug(path: str) -> str:
    """Convert a command's name to its page name, such as "prepare gopro-fc" to "prepare-gopro-fc"."""
    return path.replace(" ", "-")


def index() -> str:
    """The page of all commands, with the options that precede any command."""
    root = typer.main.get_command(app)
    lines = ["# Command line", "", "Every command and option, as `robustflow COMMAND --help` prints them.", ""]
    lines += ["| command | what it does |", "|---|---|"]
    for path, command in commands():
        lines.append(f"| [`robustflow {path}`]({slug(path)}.md) | {_cell(_text(command.help)[0].splitlines()[0])} |")
    lines += ["", "## Options before a command", "", *_options(root)]
    lines += [
        "",
        "An error is one line on the standard error output. The exit code is 0 for success, 1 for an error, 2 for an "
        "invalid command, 3 for inconsistent numbers (`reproduce audit`), and 130 for a run that was stopped. "
        "`--debug` prints the traceback.",
    ]
    return "\n".join(lines) + "\n"


def page(path: str, command: Any) -> str:
    """The page of one command."""
    description, examples = _text(command.help)
    usage = [f"robustflow {path}", "[OPTIONS]"]
    usage += [_metavar(argument) for argument in _arguments(command)]
    lines = [f"# robustflow {path}", "", description, "", "<!-- not run: the form of the command -->", "```text"]
    lines += [" ".join(usage), "```", ""]
    if examples:
        lines += ["## Examples", "", "```bash", *examples, "```", ""]
    arguments = _arguments(command)
    if arguments:
        lines += ["## Arguments", "", "| argument | meaning |", "|---|---|"]
        lines += [f"| `{_metavar(a)}` | {_cell(a.help)} |" for a in arguments] + [""]
    lines += ["## Options", "", *_options(command)]
    return "\n".join(lines) + "\n"


def _arguments(command: Any) -> list[Any]:
    return [parameter for parameter in command.params if parameter.param_type_name == "argument"]


def _options(command: Any) -> list[str]:
    lines = ["| option | value | default | meaning |", "|---|---|---|---|"]
    for option in command.params:
        if option.param_type_name == "option":
            names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
            value = "" if option.is_flag else f"`{_value(option)}`"
            meaning = option.help or _COMPLETION.get(option.name, "")
            required = "required" if option.required else _default(option)
            lines.append(f"| {names} | {value} | {required} | {_cell(meaning)} |")
    return [*lines, "| `-h`, `--help` | | | Print the help. |"]


def _value(option: Any) -> str:
    kind = option.metavar or _value_of(option.type_descriptor.annotation)
    return f"{kind} ..." if option.multiple else kind


def _value_of(annotation: Any) -> str:
    """The placeholder for a value of a type: N, X, PATH or TEXT."""
    kinds = {annotation, *typing.get_args(annotation)}
    known = {int: "N", float: "X", Path: "PATH"}
    return next((text for kind, text in known.items() if kind in kinds), "TEXT")


def _default(option: Any) -> str:
    value = option.default
    empty = value is None or value is False or value == () or value == [] or callable(value) or value == ""
    if option.is_flag and value is True:
        return f"`{option.opts[0]}`"
    return "" if empty or "UNSET" in str(value).upper() else f"`{value}`"


def _metavar(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    name = f"{name}..." if argument.nargs != 1 else name
    return name if argument.required else f"[{name}]"


def _text(help_text: str | None) -> tuple[str, list[str]]:
    """The description in Markdown, and the lines of its examples."""
    text = re.sub(r"\s*\x08?\\?b?\n(?=\s*Examples?:)", "\n", help_text or "")
    description, _, examples = re.sub("\x08", "", text).partition("\nExample")
    lines = [line.strip() for line in examples.partition("\n")[2].splitlines()]
    return description.strip(), [line for line in lines if line]


def _cell(text: str | None) -> str:
    """Escape text so that it fits a table cell."""
    return " ".join((text or "").split()).replace("|", r"\|").replace("<", "&lt;")
