"""Table that shows how well a model's confidence predicts its errors."""

from __future__ import annotations

from ..analysis.confidence import ConfidenceScore, confidence_scores
from ..analysis.labels import FAMILY_LABELS
from ..analysis.results import AVERAGE
from ..metrics.rows import CLEAN
from ..runs.run import Run
from .table import Column, Line, Section, Table

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
