"""Table that shows how well a model's confidence predicts its errors. Robustness metrics that depend less on
accuracy than the paper's, one line per run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple

from ..core.errors import UsageError
from ..metrics.rows import CLEAN
from ..run.run import Run
from ..stats.confidence import ConfidenceScore, confidence_scores
from ..stats.model_result import ModelResult
from ..stats.results import AVERAGE, FAMILY_LABELS
from ..stats.uncoupled import Coupling, Uncoupled, coupling, uncoupled
from .table import Column, Line, Section, Table, full_note

_COLUMNS = (
    "AUSE (px)",
    "AUSE, normalised",
    "error at 80 % (px)",
    "error at 50 % (px)",
    "Spearman",
    "rejected (%)",
)
_REMARK = (
    "AUSE: area between the sparsification curve and the oracle's; 0 if the least confident pixels have the largest "
    "errors. Normalised: divided by the error of each image. Error at 80 %: error of the 80 % most confident pixels. "
    "Spearman: rank correlation of confidence and error; -1 is best. Rejected: share of pixels rejected by the "
    "forward-backward check of Sundaram et al. 2010."
)
_NAMES = {CLEAN: "Clean", AVERAGE: "All corruptions"} | FAMILY_LABELS


def confidence_table(run: Run) -> Table | None:
    """Tabulate the confidence scores of a run by corruption family and by severity; return None if it has none."""
    scores = confidence_scores(run)
    if not scores:
        return None
    whole = tuple(_line(score, _NAMES[score.family]) for score in scores if score.severity is None)
    each = tuple(
        _line(score, f"{_NAMES[score.family]} {score.severity}") for score in scores if score.severity is not None
    )
    sections = (Section("Means", whole), *((Section("By severity", each),) if each else ()))
    title = f"Confidence ({run.manifest.identity.measuring.confidence})"
    table = Table("confidence", title, tuple(map(Column, _COLUMNS)), sections, (_REMARK,), "Corruptions")
    return table.without_empty_columns()


def _line(score: ConfidenceScore, label: str) -> Line:
    values = (score.ause, score.ause_normalised, score.error_80, score.error_50, score.spearman, score.rejected)
    return Line.of_numbers(label, values)


_COLUMNS_UNCOUPLED_TABLE = (
    "clean EPE (px)",
    "CRE (px)",
    "log ratio",
    "median log ratio",
    "median CRE (px)",
    "Fl increase (points)",
    "rank correlation",
    "given the motion",
)
_REMARK_UNCOUPLED_TABLE = (
    "log ratio: ln(EPE / clean EPE), averaged over images; 0.69 if errors double. Medians are over images. "
    "Fl increase: percentage points of Fl-all. Rank correlation: between corrupted and clean EPE over images, first "
    "uncontrolled, then controlled for the true flow magnitude. CRE is EPE - clean EPE, so it depends on accuracy."
)


def uncoupled_table(results: Sequence[ModelResult]) -> Table:
    """Tabulate `uncoupled` for runs. With five or more ranked models on the same frames, add the correlations of CRE
    and log ratio with accuracy.
    """
    lines = []
    same_frames: dict[str, list[tuple[float, float, float]]] = {}
    for result in results:
        if (run := result.run) is None:
            continue
        measured = uncoupled(run.rows)
        if measured.overall.log_ratio is None and measured.overall.median_cre is None:
            continue
        lines.append(Line.of_numbers(result.name, _numbers(run, measured), full_note(result)))
        clean, cre, ratio = run.epe_clean, run.cre, measured.overall.log_ratio
        if clean is not None and cre is not None and ratio is not None and not result.excluded:
            same_frames.setdefault(result.frames, []).append((clean, cre, ratio))
    if not lines:
        raise UsageError("the table 'uncoupled' needs ground truth, which none of these runs has")
    couplings = (coupling(*map(list, zip(*models, strict=True))) for models in same_frames.values())
    remarks = tuple(_sentence(one) for one in couplings if one is not None)
    columns = tuple(map(Column, _COLUMNS_UNCOUPLED_TABLE))
    return Table(
        "uncoupled",
        "Robustness beside accuracy",
        columns,
        (Section("Runs", tuple(lines)),),
        (_REMARK_UNCOUPLED_TABLE, *remarks),
    )


def _numbers(run: Run, measured: Uncoupled) -> tuple[float | None, ...]:
    related = measured.correlation.get(AVERAGE)
    correlations = (related.rho, related.given_motion) if related else (None, None)
    return run.epe_clean, run.cre, *astuple(measured.overall), *correlations


def _sentence(coupling: Coupling) -> str:
    cre, ratio = ("cannot be computed" if v is None else f"{v:+.2f}" for v in (coupling.cre, coupling.log_ratio))
    return (
        f"Over {coupling.models} models on the same frames, the rank correlation with the clean EPE is {cre} for CRE "
        f"and {ratio} for the log ratio."
    )
