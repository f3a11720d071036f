"""Everything a user can name: Python names with their signatures, commands with their options.

python -m tests.public_surface > tests/public_surface.txt    writes what there is now, when a name is added
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer

import robustflow
import robustflow.testing
from robustflow.cli.main import app
from robustflow.errors import ModelError


def surface() -> list[str]:
    """One line for each name."""
    lines = [*_python(robustflow), *_python(robustflow.testing)]
    return sorted([*lines, *_commands(typer.main.get_command(app), "robustflow")])


def _python(module: object) -> Iterator[str]:
    home = module.__name__  # type: ignore[attr-defined]
    for name in module.__all__:  # type: ignore[attr-defined]
        try:
            thing = getattr(module, name)
        except ModelError:  # it needs an extra that is not installed
            continue
        yield f"{home}.{name}{_parameters(thing)}"
        if inspect.isclass(thing):
            for part, value in inspect.getmembers(thing):
                if not part.startswith("_") and not part.startswith("model_"):
                    yield f"{home}.{name}.{part}{_parameters(value)}"


def _parameters(thing: object) -> str:
    """Names of parameters, in order; those with a default are marked, as they may be left out."""
    if not callable(thing):
        return ""
    try:
        parameters = inspect.signature(thing).parameters.values()
    except (ValueError, TypeError):
        return "(...)"
    return "(" + ", ".join(p.name + ("=" if p.default is not p.empty else "") for p in parameters) + ")"


def _commands(command: Any, path: str) -> Iterator[str]:
    yield path
    for parameter in command.params:
        for option in parameter.opts + parameter.secondary_opts:
            yield f"{path} {option if option.startswith('-') else f'<{option}>'}"
    for name, child in getattr(command, "commands", {}).items():
        yield from _commands(child, f"{path} {name}")


if __name__ == "__main__":
    print("\n".join(surface()))
