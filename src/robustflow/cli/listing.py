"""`robustflow list`: what there is."""

from __future__ import annotations

from typing import Annotated

import typer

from ..errors import unknown_name

KINDS = ("models", "corruptions", "benchmarks", "datasets")


def list_things(
    kind: Annotated[str, typer.Argument(help="models, corruptions, benchmarks or datasets; all by default.")] = "all",
) -> None:
    """List models, corruptions, benchmarks or datasets.

    \b
    Example:
      robustflow list corruptions
    """
    from rich.console import Console

    if kind != "all" and kind not in KINDS:
        raise unknown_name("kind", kind, (*KINDS, "all"))
    console = Console(soft_wrap=True)
    for name in KINDS if kind == "all" else (kind,):
        if kind == "all":
            console.print(f"\n[bold]{name}[/bold]")
        for line in _LISTERS[name]():
            console.print(line, highlight=False, markup=False)


def _models() -> list[str]:
    from ..models import MODELS

    return MODELS.names()


def _corruptions() -> list[str]:
    from ..corruptions import CORRUPTIONS

    lines = []
    for name in CORRUPTIONS.names():
        kind = CORRUPTIONS.get(name)
        parameters = ", ".join(str(value) for value in kind.paper_severities)
        lines.append(f"{name:20s} {kind.family:13s} {'temporal' if kind.temporal else '':9s} {parameters}")
    return lines


def _benchmarks() -> list[str]:
    from ..benchmarks import BENCHMARKS

    lines = [f"{name:10s} {_first_line(BENCHMARKS.get(name))}" for name in BENCHMARKS.names()]
    return [*lines, f"{'DATASET':10s} Any data set by its name, under every image-pair corruption."]


def _datasets() -> list[str]:
    from ..datasets import DATASETS

    return [f"{name:16s} {_first_line(DATASETS.get(name))}" for name in DATASETS.names()]


def _first_line(thing: object) -> str:
    return (thing.__doc__ or "").strip().partition("\n")[0]


_LISTERS = {"models": _models, "corruptions": _corruptions, "benchmarks": _benchmarks, "datasets": _datasets}
