"""Observations 9 and 10: small displacements (GoPro-FC)."""

from __future__ import annotations

from statistics import median

from ..results import AVERAGE
from .evidence import Evidence, ModelInSetting
from .verdict import Observation, part

_FLOWFORMER: ModelInSetting = ("OOD", "FlowFormer")
_NEEDS = "needs GoPro-FC results of FlowFormer and others"


def flowformer_is_best(evidence: Evidence) -> Observation:
    """9: FlowFormer has the lowest average RCRE, and the lowest under most corruptions."""
    title = "FlowFormer shows as the best robust model in small displacement condition"
    rcre = {entry: values for entry, values in evidence.rcre.items() if AVERAGE in values}
    claim = "FlowFormer has the lowest average RCRE"
    if _FLOWFORMER not in rcre or len(rcre) < 2:
        return Observation(number=9, title=title, parts=[part(claim, None, _NEEDS, True)])
    order = sorted(rcre, key=lambda entry: rcre[entry][AVERAGE])
    names = [name for name in rcre[_FLOWFORMER] if name != AVERAGE and all(name in v for v in rcre.values())]
    best = [name for name in names if rcre[_FLOWFORMER][name] == min(v[name] for v in rcre.values())]
    cnn = _of_encoder(evidence, order, "CNN")
    parts = [
        part(
            claim,
            order[0] == _FLOWFORMER,
            ", ".join(f"{entry[1]} {rcre[entry][AVERAGE]:.2f}" for entry in order[:3]),
            True,
        ),
        part(
            "FlowFormer has the lowest RCRE under most corruptions",
            len(best) > len(names) / 2,
            f"under {len(best)} of {len(names)}",
            numbers={"best": len(best), "corruptions": len(names)},
        ),
        part(
            "SKFlow has the lowest average RCRE of the CNN-based models",
            cnn[0][1] == "SKFlow" if cnn else None,
            ", ".join(f"{entry[1]} {rcre[entry][AVERAGE]:.2f}" for entry in cnn[:3]),
        ),
    ]
    return Observation(number=9, title=title, parts=parts)


def foundation_model_does_not_help(evidence: Evidence) -> Observation:
    """10: every SAMFlow has a higher average RCRE than FlowFormer, and is not better than the median CNN."""
    title = "VFM does not help in small displacement condition"
    rcre = {entry: values[AVERAGE] for entry, values in evidence.rcre.items() if AVERAGE in values}
    sam = [entry for entry in rcre if (method := evidence.method(entry[1])) is not None and method.method == "SAMFlow"]
    cnn = [rcre[entry] for entry in _of_encoder(evidence, list(rcre), "CNN")]
    claim = "every SAMFlow has a higher average RCRE than FlowFormer, the same architecture without it"
    if _FLOWFORMER not in rcre or not sam or not cnn:
        return Observation(number=10, title=title, parts=[part(claim, None, _NEEDS, True)])
    best, middle = min(rcre[entry] for entry in sam), median(cnn)
    says = ", ".join(f"{entry[1]} {rcre[entry]:.2f}" for entry in [_FLOWFORMER, *sam])
    parts = [
        part(claim, best > rcre[_FLOWFORMER], says, True),
        part(
            "every SAMFlow is as bad as most CNN-based models",
            best >= middle,
            f"best SAMFlow {best:.2f}, middle of {len(cnn)} CNN-based models {middle:.2f}",
            True,
            {"best_samflow": best, "middle_cnn": middle},
        ),
    ]
    return Observation(number=10, title=title, parts=parts)


def _of_encoder(evidence: Evidence, entries: list[ModelInSetting], encoder: str) -> list[ModelInSetting]:
    return [e for e in entries if (method := evidence.method(e[1])) is not None and method.encoder == encoder]
