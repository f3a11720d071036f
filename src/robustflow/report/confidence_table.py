"""Table that shows how well a model's confidence predicts its errors. Robustness metrics that depend less on
accuracy than the paper's, one line per run.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..core.arguments import SEVERITIES
from ..core.errors import UsageError
from ..metrics.rows import CLEAN
from ..run.run import Run
from ..stats.frame import confidence_means, uncoupled_means
from ..stats.model_result import ModelResult
from ..stats.ranking import LEAST_MODELS, spearman
from ..stats.results import AVERAGE, FAMILY_LABELS
from .table import Column, Line, Section, Table, full_note

_COLUMNS = {
    "ause": "AUSE (px)",
    "ause_normalised": "AUSE, normalised",
    "error_at_80": "error at 80 % (px)",
    "error_at_50": "error at 50 % (px)",
    "confidence_spearman": "Spearman",
    "rejected": "rejected (%)",
}
_REMARK = (
    "AUSE: area between the sparsification curve and the oracle's; 0 if the least confident pixels have the largest "
    "errors. Normalised: divided by the error of each image. Error at 80 %: error of the 80 % most confident pixels. "
    "Spearman: rank correlation of confidence and error; -1 is best. Rejected: share of pixels rejected by the "
    "forward-backward check of Sundaram et al. 2010."
)
_NAMES = {CLEAN: "Clean", AVERAGE: "All corruptions"} | FAMILY_LABELS


def confidence_table(run: Run) -> Table | None:
    """Tabulate the confidence scores of a run by corruption family and by severity; return None if it has none."""
    known = confidence_means(run.rows)
    if not known:
        return None
    at = dict.fromkeys((condition, severity) for _, condition, severity in known)
    places = [(name, level) for name in _NAMES for level in (None, *SEVERITIES) if (name, level) in at]

    def line(condition: str, severity: int | None) -> Line:
        label = _NAMES[condition] if severity is None else f"{_NAMES[condition]} {severity}"
        return Line.of_numbers(label, (known.get((measure, condition, severity)) for measure in _COLUMNS))

    whole = tuple(line(*place) for place in places if place[1] is None)
    each = tuple(line(*place) for place in places if place[1] is not None and place[0] in FAMILY_LABELS)
    sections = (Section("Means", whole), *((Section("By severity", each),) if each else ()))
    title = f"Confidence ({run.manifest.identity.measuring.confidence})"
    table = Table("confidence", title, tuple(map(Column, _COLUMNS.values())), sections, (_REMARK,), "Corruptions")
    return table.without_empty_columns()


_UNCOUPLED_COLUMNS = {
    "log_ratio": "log ratio",
    "median_log_ratio": "median log ratio",
    "median_cre": "median CRE (px)",
    "fl_increase": "Fl increase (points)",
    "rank_correlation": "rank correlation",
    "rank_correlation_given_motion": "given the motion",
}
_UNCOUPLED_REMARK = (
    "log ratio: ln(EPE / clean EPE), averaged over images; 0.69 if errors double. Medians are over images. "
    "Fl increase: percentage points of Fl-all. Rank correlation: between corrupted and clean EPE over images, first "
    "uncontrolled, then controlled for the true flow magnitude. CRE is EPE - clean EPE, so it depends on accuracy."
)


def uncoupled_table(results: Sequence[ModelResult]) -> Table:
    """Tabulate `UNCOUPLED` measures of runs. With five or more ranked models on the same frames, add the correlations
    of CRE and log ratio with accuracy.
    """
    lines = []
    same_frames: dict[str, list[tuple[float, float, float]]] = {}
    for result in results:
        if (run := result.run) is None:
            continue
        known = uncoupled_means(run.rows)
        numbers = [known.get((measure, AVERAGE, None)) for measure in _UNCOUPLED_COLUMNS]
        ratio, median_cre = numbers[0], numbers[2]
        if ratio is None and median_cre is None:
            continue
        lines.append(Line.of_numbers(result.name, (run.epe_clean, run.cre, *numbers), full_note(result)))
        if run.epe_clean is not None and run.cre is not None and ratio is not None and not result.excluded:
            same_frames.setdefault(result.frames, []).append((run.epe_clean, run.cre, ratio))
    if not lines:
        raise UsageError("the table 'uncoupled' needs ground truth, which none of these runs has")
    remarks = tuple(_coupling(models) for models in same_frames.values() if len(models) >= LEAST_MODELS)
    columns = tuple(map(Column, ("clean EPE (px)", "CRE (px)", *_UNCOUPLED_COLUMNS.values())))
    return Table(
        "uncoupled",
        "Robustness beside accuracy",
        columns,
        (Section("Runs", tuple(lines)),),
        (_UNCOUPLED_REMARK, *remarks),
    )


def _coupling(models: Sequence[tuple[float, float, float]]) -> str:
    """State how strongly CRE and the log ratio correlate with the clean EPE over models."""
    clean, *others = map(list, zip(*models, strict=True))
    cre, ratio = ("cannot be computed" if (v := spearman(clean, one)) is None else f"{v:+.2f}" for one in others)
    return (
        f"Over {len(models)} models on the same frames, the rank correlation with the clean EPE is {cre} for CRE "
        f"and {ratio} for the log ratio."
    )
