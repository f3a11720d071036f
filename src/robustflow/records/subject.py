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
    """The model, data and scores of a record. Scores are recomputed from the rows, never read from the stored means.

    Attributes:
        model, benchmark: names of the model and the benchmark, safe to print.
        truth: a remark about unusual ground truth, or "".
        pairs, corruptions, severities: number of pairs, corruptions and severities evaluated.
        uneven: whether not all of their combinations were evaluated, see `Manifest.uneven`.
        setting: the setting that follows from the training sets: OOD, ID, LEAKED, ...
        epe_clean, epe, cre, rcre: scores in pixels; None without ground truth. `crer` is a ratio.
    """

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
        """Return all fields in one line.

        >>> scores = {"epe_clean": 1.0, "epe": 3.0, "cre": 2.0, "crer": 2.0, "rcre": None}
        >>> counts = {"pairs": 1, "corruptions": 2, "severities": 5}
        >>> Subject(model="dis", benchmark="demo", setting="knowledge", **counts, **scores).sentence()
        'dis on demo (knowledge), 1 pair x 2 corruptions x 5 severities: clean EPE 1.00, EPE 3.00, CRE 2.00, CREr 2.00'
        """
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
