"""The paper's tables and figures, and which of them can be reproduced."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..benchmarks import benchmark_facts
from ..errors import unknown_name

ColumnChoice = Literal["epe", "cre", "rcre", "crer", "means", "families"]
"""Kind of comparison: a metric under each corruption, overall means, or CREr by corruption family."""


@dataclass(frozen=True)
class Artefact:
    """A table or a figure in the paper."""

    name: str
    title: str
    benchmark: str = ""
    columns: ColumnChoice = "epe"
    table: str = ""
    figure: str = ""
    instead: str = ""


_ALL = (
    Artefact("tab1", "The 15 evaluated methods", instead="robustflow list models, without encoders and decoders"),
    Artefact("tab2", "EPE on KITTI-FC", "kitti-fc", "epe", table="epe"),
    Artefact(
        "tab3",
        "CREr and computing cost",
        "kitti-fc",
        "crer",
        table="cost",
        instead="its parameters and FLOPs next to ours: robustflow profile --paper",
    ),
    Artefact("tab4", "RCRE on GoPro-FC", "gopro-fc", "rcre", table="gopro-rcre"),
    Artefact("tab5", "Training of the supervised OOD models", instead="robustflow train MODEL --recipe ood --plan"),
    Artefact("tab6", "Training of the supervised ID models", instead="robustflow train MODEL --recipe id --plan"),
    Artefact("tab7", "CRE on KITTI-FC", "kitti-fc", "cre", table="cre"),
    Artefact("tab8", "RCRE on KITTI-FC", "kitti-fc", "rcre", table="rcre"),
    Artefact("fig1", "The benchmarks, as a drawing", instead="no command, as it is a drawing"),
    Artefact(
        "fig2",
        "The 24 corruptions at severity 5",
        instead="robustflow gallery --severity 5, which shows 20 of them; --clip CLIP adds the video corruptions "
        "(object_motion_blur needs intermediate frames)",
    ),
    Artefact(
        "fig3",
        "How CRE and RCRE are computed, as a drawing",
        instead="robustflow report RUN --examples draws frames, flows and errors for pairs of a run",
    ),
    Artefact("fig4", "Clean EPE, CRE and CREr on KITTI-FC", "kitti-fc", "means", figure="clean_against_cre"),
    Artefact("fig5", "CREr by corruption class", "kitti-fc", "families", figure="crer_by_family"),
    Artefact("fig6", "SAM's segmentation of the frames", instead="no command, as it contains no flow measurements"),
    Artefact("fig7", "The PSFs of psf_blur", instead="robustflow optics show"),
    Artefact(
        "fig8", "Distribution of flow magnitudes", instead="robustflow reproduce displacement BENCHMARK --data DATA"
    ),
    Artefact("fig9", "Scatter plots of clean EPE, EPE, CRE and RCRE", "kitti-fc", "means", figure="relations"),
)

ARTEFACTS = {artefact.name: artefact for artefact in _ALL}
"""Every table and figure of the paper, by name."""


def artefact_of(name: str) -> Artefact:
    """Return a table or figure by name.

    >>> artefact_of("tab2").title
    'EPE on KITTI-FC'
    """
    if name.lower() not in ARTEFACTS:
        raise unknown_name("table or figure", name, ARTEFACTS)
    return ARTEFACTS[name.lower()]


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
