"""Observations 9 and 10: robustness under small displacements (GoPro-FC)."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median

from ..results import AVERAGE
from .evidence import Evidence, ModelInSetting
from .margin import Margin, among, of_majority, of_mean, places
from .verdict import THIN, UNKNOWN, Observation, Statement, part, unknown

_FLOWFORMER: ModelInSetting = ("OOD", "FlowFormer")
_NEEDS = "needs GoPro-FC results for FlowFormer and other models"


def flowformer_is_best(evidence: Evidence) -> Observation:
    """Check observation 9: FlowFormer has the lowest RCRE, on average and under most corruptions."""
    title = "FlowFormer shows as the best robust model in small displacement condition"
    rcre = {entry: values for entry, values in evidence.rcre.items() if AVERAGE in values}
    claim = "FlowFormer has the lowest average RCRE"
    if _FLOWFORMER not in rcre or len(rcre) < 2:
        return unknown(9, title, claim, _NEEDS)
    order = sorted(rcre, key=lambda entry: rcre[entry][AVERAGE])
    names = _common(evidence, order)
    best = [name for name in names if rcre[_FLOWFORMER][name] == min(v[name] for v in rcre.values())]
    parts = [_lowest(evidence, claim, _FLOWFORMER, order, True)]
    claim = "FlowFormer has the lowest RCRE under most corruptions"
    if names:
        verdict = of_majority(len(best), len(names), "corruption").verdict
        numbers = {"best": float(len(best)), "corruptions": float(len(names))}
        parts.append(part(claim, verdict, f"under {len(best)} of {len(names)}", numbers=numbers))
    cnn = _cnn_based(evidence, order)
    claim = "SKFlow has the lowest average RCRE of the CNN-based models"
    skflow = next((entry for entry in cnn if entry[1] == "SKFlow"), None)
    parts.append(part(claim, UNKNOWN, "none") if skflow is None else _lowest(evidence, claim, skflow, cnn))
    return Observation(number=9, title=title, parts=parts)


def _common(evidence: Evidence, entries: Sequence[ModelInSetting]) -> list[str]:
    """List the corruptions under which all of these models were measured."""
    first, *others = (evidence.rcre[entry] for entry in entries)
    return [name for name in first if name != AVERAGE and all(name in values for values in others)]


def _lowest(
    evidence: Evidence, claim: str, entry: ModelInSetting, order: Sequence[ModelInSetting], main: bool = False
) -> Statement:
    """Check whether a model has the lowest RCRE among the best models of all families, listed in `order` by their
    average."""
    best: dict[str, ModelInSetting] = {}
    for other in order:
        best.setdefault(evidence.family(other), other)
    best[evidence.family(entry)] = entry
    names = _common(evidence, list(best.values()))
    message = ", ".join(f"{other[1]} {evidence.rcre[other][AVERAGE]:.2f}" for other in order[:3])
    if len(names) < 2 or len(best) < 2:
        return part(claim, THIN, message, main)
    ranks = places({family: [evidence.rcre[one][name] for name in names] for family, one in best.items()})
    first, last = ranks[evidence.family(entry)]
    message += (
        f"; possible ranks of {entry[1]}: {first} to {last} (paired tests over {len(names)} corruptions, corrected "
        f"for all pairs of {len(best)})"
    )
    return part(claim, among(1, [(first, last)]), message, main)


def foundation_model_does_not_help(evidence: Evidence) -> Observation:
    """Check observation 10: SAMFlow has a higher average RCRE than FlowFormer, and is not better than the median
    CNN."""
    title = "VFM does not help in small displacement condition"
    entries = [entry for entry, values in evidence.rcre.items() if AVERAGE in values]
    sam = [entry for entry in entries if evidence.family(entry) == "SAMFlow"]
    cnn = _cnn_based(evidence, entries)
    claim = "SAMFlow has a higher average RCRE than FlowFormer, which lacks the foundation model"
    if _FLOWFORMER not in entries or not sam or not cnn:
        return unknown(10, title, claim, _NEEDS)
    average = {entry: evidence.rcre[entry][AVERAGE] for entry in entries}
    names = _common(evidence, [_FLOWFORMER, *sam, *cnn])
    under = {
        name: (
            fmean(evidence.rcre[entry][name] for entry in sam),
            evidence.rcre[_FLOWFORMER][name],
            median(evidence.rcre[entry][name] for entry in cnn),
        )
        for name in names
    }
    than_flowformer = of_mean([own - other for own, other, _ in under.values()], "corruption") if names else None
    than_cnn = of_mean([own - other for own, _, other in under.values()], "corruption") if names else None
    best, middle = min(average[entry] for entry in sam), median(average[entry] for entry in cnn)
    message = ", ".join(f"{entry[1]} {average[entry]:.2f}" for entry in [_FLOWFORMER, *sam])
    parts = [
        part(
            claim,
            than_flowformer.verdict if than_flowformer else THIN,
            f"{message}; mean of SAMFlow - FlowFormer {_pixels_text(than_flowformer)}",
            True,
        ),
        part(
            "SAMFlow has a higher average RCRE than most CNN-based models",
            than_cnn.verdict if than_cnn else THIN,
            f"best SAMFlow {best:.2f}, median of {len(cnn)} CNN-based models {middle:.2f}; mean of SAMFlow - median "
            f"{_pixels_text(than_cnn)}",
            True,
            {"best_samflow": best, "middle_cnn": middle},
        ),
    ]
    return Observation(number=10, title=title, parts=parts)


def _pixels_text(margin: Margin | None) -> str:
    return "unknown, because the models have no corruption in common" if margin is None else margin.in_px


def _cnn_based(evidence: Evidence, entries: Sequence[ModelInSetting]) -> list[ModelInSetting]:
    return [e for e in entries if (method := evidence.method(e[1])) is not None and method.encoder == "CNN"]
