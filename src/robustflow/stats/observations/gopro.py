"""Observations 9 and 10: robustness under small displacements (GoPro-FC)."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median

from ..results import AVERAGE
from .evidence import Evidence, ModelInSetting, Observation, Statement, part
from .margin import among, of_majority, of_mean, places

_FLOWFORMER: ModelInSetting = ("OOD", "FlowFormer")


def flowformer_is_best(evidence: Evidence) -> Observation:
    """Check observation 9: FlowFormer has the lowest RCRE, on average and under most corruptions."""
    title = "FlowFormer shows as the best robust model in small displacement condition"
    rcre = evidence.rcre
    order = sorted(rcre, key=lambda entry: rcre[entry][AVERAGE])
    names = _common(evidence, order)
    best = [name for name in names if rcre[_FLOWFORMER][name] == min(v[name] for v in rcre.values())]
    cnn = _cnn_based(evidence, order)
    skflow = next(entry for entry in cnn if entry[1] == "SKFlow")
    parts = [
        _lowest(evidence, "FlowFormer has the lowest average RCRE", _FLOWFORMER, order, True),
        part(
            "FlowFormer has the lowest RCRE under most corruptions",
            of_majority(len(best), len(names), "corruption").verdict,
            f"under {len(best)} of {len(names)}",
            numbers={"best": float(len(best)), "corruptions": float(len(names))},
        ),
        _lowest(evidence, "SKFlow has the lowest average RCRE of the CNN-based models", skflow, cnn),
    ]
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
    entries = list(evidence.rcre)
    sam = [entry for entry in entries if evidence.family(entry) == "SAMFlow"]
    cnn = _cnn_based(evidence, entries)
    claim = "SAMFlow has a higher average RCRE than FlowFormer, which lacks the foundation model"
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
    than_flowformer = of_mean([own - other for own, other, _ in under.values()], "corruption")
    than_cnn = of_mean([own - other for own, _, other in under.values()], "corruption")
    best, middle = min(average[entry] for entry in sam), median(average[entry] for entry in cnn)
    message = ", ".join(f"{entry[1]} {average[entry]:.2f}" for entry in [_FLOWFORMER, *sam])
    parts = [
        part(
            claim,
            than_flowformer.verdict,
            f"{message}; mean of SAMFlow - FlowFormer {than_flowformer.in_px}",
            True,
        ),
        part(
            "SAMFlow has a higher average RCRE than most CNN-based models",
            than_cnn.verdict,
            f"best SAMFlow {best:.2f}, median of {len(cnn)} CNN-based models {middle:.2f}; mean of SAMFlow - median "
            f"{than_cnn.in_px}",
            True,
            {"best_samflow": best, "middle_cnn": middle},
        ),
    ]
    return Observation(number=10, title=title, parts=parts)


def _cnn_based(evidence: Evidence, entries: Sequence[ModelInSetting]) -> list[ModelInSetting]:
    return [entry for entry in entries if evidence.method(entry[1]).encoder == "CNN"]
