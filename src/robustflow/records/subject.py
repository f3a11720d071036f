"""The subject of a record: which model was evaluated on which data, and what no check of the file can prove."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..benchmarks.facts import truth_remark
from ..runs.cells import UNEVEN
from ..text import counted, plain
from ..validated import Frozen

if TYPE_CHECKING:
    from ..runs.manifest import Manifest
    from ..runs.run import Run


class Subject(Frozen):
    """The model, data and scores of a record. Scores are recomputed from the rows, never read from the stored means."""

    model: str
    benchmark: str
    truth: str = ""
    pairs: int
    corruptions: int
    severities: int
    uneven: bool = False
    setting: str
    epe_clean: float | None
    epe: float | None
    cre: float | None
    crer: float | None
    rcre: float | None

    def sentence(self) -> str:
        """Return all fields in one line."""
        named = {"clean EPE": self.epe_clean, "EPE": self.epe, "CRE": self.cre, "CREr": self.crer, "RCRE": self.rcre}
        scores = ", ".join(f"{name} {value:.2f}" for name, value in named.items() if value is not None)
        on = f"{self.benchmark}, {self.truth}" if self.truth else self.benchmark
        pairs, corruptions = counted(self.pairs, "pair"), counted(self.corruptions, "corruption")
        extent = f"{pairs} x {corruptions} x {counted(self.severities, 'severity', 'severities')}"
        extent += f" ({UNEVEN})" if self.uneven else ""
        return f"{self.model} on {on} ({self.setting}), {extent}: {scores or 'nothing could be measured'}"


def subject_of(run: Run, plan: Manifest) -> Subject:
    """Return the subject of a record whose rows and plan were checked."""
    summary = run.summary
    return Subject(
        model=plain(run.name),
        benchmark=plain(run.benchmark),
        truth=truth_remark(plan.identity.frames.protocol),
        pairs=summary.samples,
        corruptions=len(plan.corruptions),
        severities=len(plan.severities),
        uneven=plan.uneven,
        setting=run.setting,
        epe_clean=summary.epe_clean,
        epe=summary.epe,
        cre=summary.cre,
        crer=summary.crer,
        rcre=summary.rcre,
    )


def unproven(frames_compared: bool, predictions_compared: bool, attacked: bool) -> list[str]:
    """Return the unproven claims as sentences; each names a way to prove the claim."""
    out = []
    if not frames_compared:
        out.append("that the rows were measured on these data: --data FOLDER recomputes the frames of some rows")
    if not predictions_compared:
        out.append("that this model made the predictions: --data FOLDER --model NAME predicts some rows again")
    if attacked:
        out.append("that the attacks were run on this model: no check repeats them; run them again")
    out.append("what the model was trained on, if that is only declared and not known from a checkpoint's hash")
    return out
