"""Messages that list the variants that can be run, and how to obtain weights and data for the others."""

from __future__ import annotations

from collections.abc import Sequence

from ..analysis.labels import SETTING_LABELS
from ..benchmarks import benchmark_facts
from ..report.table import Column, Line, Section, Table
from ..text import counted
from .artefacts import ARTEFACTS, Artefact
from .plan import Missing, Runnable


def plan_table(artefact: Artefact, choices: Sequence[Runnable | Missing]) -> Table:
    """Return the weights each variant would run with, or what the variant requires."""
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
    """Return a sentence with the number of variants that can be run."""
    runnable = [choice for choice in choices if isinstance(choice, Runnable)]
    random = sum(choice.random for choice in runnable)
    text = f"{len(runnable)} of {counted(len(choices), 'variant')} can be run here"
    return f"{text}, {random} of them with RANDOM WEIGHTS." if random else f"{text}."


def data_hint(artefact: Artefact) -> str:
    """Return a sentence that explains how to reproduce a table or figure."""
    return (
        f"To reproduce it, run: robustflow reproduce {artefact.name} --data FOLDER "
        f"({benchmark_facts(artefact.benchmark).data}) --checkpoints FOLDER; --dry-run lists the models that can be "
        "run, and where to get weights for the others."
    )


def contents() -> list[str]:
    """Return one line per table and figure: its title, and its benchmark or the command that shows the same content."""
    return [
        f"{artefact.name:5s} {artefact.title}"
        + (f" (--data: {artefact.benchmark})" if artefact.benchmark else f": {artefact.instead}")
        for artefact in ARTEFACTS.values()
    ]
