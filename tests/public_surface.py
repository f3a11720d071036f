"""Everything a user can refer to: Python names with their signatures, commands with their options.

`python -m tests.rewrite` updates the list, tests/public_surface.txt, after a name is added.
"""

import inspect
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import typer

import robustflow
import robustflow.metrics
import robustflow.testing
from robustflow.cli.main import app
from robustflow.core.errors import AssetError

STORED = Path(__file__).with_suffix(".txt")
"""The list that the code is compared with."""
_METRICS = ("epe", "fl_all", "rcre")
"""The functions of `robustflow.metrics` that accept a user's arrays."""


def surface() -> list[str]:
    """Return one line for each name."""
    homes = (
        (robustflow, robustflow.__all__),
        (robustflow.testing, robustflow.testing.__all__),
        (robustflow.metrics, _METRICS),
    )
    lines = [line for module, names in homes for line in _python(module, names)]
    return sorted([*lines, *_commands(typer.main.get_command(app), "robustflow")])


def without_torch() -> list[str]:
    """The stored lines that cannot be computed here, because PyTorch is not installed."""
    lines = STORED.read_text(encoding="utf-8").splitlines()
    return [] if find_spec("torch") else [line for line in lines if line.startswith("robustflow.TorchModel")]


def _python(module: ModuleType, names: Iterable[str]) -> Iterator[str]:
    home = module.__name__
    for name in names:
        try:
            thing = getattr(module, name)
        except AssetError:  # it needs an extra that is not installed
            continue
        if inspect.ismodule(thing):
            continue
        yield f"{home}.{name}{_parameters(thing)}"
        if inspect.isclass(thing):
            for part, value in inspect.getmembers(thing):
                if not part.startswith(("_", "model_")) and not hasattr(Exception, part):
                    yield f"{home}.{name}.{part}{_parameters(value)}"


def _parameters(thing: object) -> str:
    """Names of parameters, in order; those with a default are marked, because they are optional."""
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
