"""What cannot be run here and how to get it; what a table needs that has no data."""

from __future__ import annotations

from collections.abc import Sequence

from ..analysis.labels import SETTING_LABELS
from ..benchmarks import benchmark_facts
from ..report.table import Column, Line, Section, Table
from ..text import counted
from .artefacts import ARTEFACTS, Artefact
from .plan import Missing, Runnable


def plan_table(artefact: Artefact, choices: Sequence[Runnable | Missing]) -> Table:
    """What each variant would be run with, or what it needs."""
    lines: dict[str, list[Line]] = {}
    for choice in choices:
        if isinstance(choice, Missing):
            texts = ("no", choice.reason, choice.remedy)
        else:
            texts = ("yes", choice.weights or "needs no weights", "")
        lines.setdefault(choice.variant.setting, []).append(Line.of(choice.variant.method, texts))
    columns = (Column("Runs"), Column("Weights", prose=True), Column("How to get it", prose=True))
    sections = tuple(Section(SETTING_LABELS.get(setting, setting), tuple(some)) for setting, some in lines.items())
    return Table(f"{artefact.name}-plan", f"{artefact.name}: what can be run here", columns, sections)


def summary_sentence(choices: Sequence[Runnable | Missing]) -> str:
    """How many of the variants can be run."""
    runnable = [choice for choice in choices if isinstance(choice, Runnable)]
    random = sum(choice.random for choice in runnable)
    text = f"{len(runnable)} of {counted(len(choices), 'variant')} can be run here"
    return f"{text}, {random} of them with RANDOM WEIGHTS." if random else f"{text}."


def data_hint(artefact: Artefact) -> str:
    """What to give so that a table or figure is measured again."""
    return (
        f"To measure it again: robustflow reproduce {artefact.name} --data FOLDER "
        f"({benchmark_facts(artefact.benchmark).data}) --checkpoints FOLDER; --dry-run says which of the models can be "
        "run, and where the others' weights are."
    )


def contents() -> list[str]:
    """A line for each table and figure: what it shows, and on what it is measured or what shows the same."""
    return [
        f"{artefact.name:5s} {artefact.title}"
        + (f" (--data: {artefact.benchmark})" if artefact.benchmark else f": {artefact.instead}")
        for artefact in ARTEFACTS.values()
    ]
