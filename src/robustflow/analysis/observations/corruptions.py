"""Observations 7 and 8: which corruptions are serious."""

from __future__ import annotations

from statistics import fmean

from .evidence import Evidence, ModelInSetting, named
from .verdict import Observation, part

_LOCAL = ("gaussian_noise", "shot_noise", "impulse_noise", "jpeg_compression", "spatter", "frost", "snow")
_VISUAL = ("contrast", "saturate", "fog")


def dark_and_overexposed(evidence: Evidence) -> Observation:
    """7: on average over models, Low-Light costs more than High-Light and Over than Under Exposure."""
    parts = []
    for worse, milder in (("low_light", "high_light"), ("over_exposure", "under_exposure")):
        every = [entry for entry in evidence.entries if evidence.has(entry, worse, milder)]
        discussed = [e for s in evidence.settings() for e in evidence.discussed(s) if e in set(every)]
        claim = f"{worse} has a higher EPE than {milder}"
        if not discussed:
            parts.append(part(f"{claim}, on average over models", None, "no model was measured under both", True))
            continue
        gap = {entry: evidence.epe(entry, worse) - evidence.epe(entry, milder) for entry in every}
        mean = fmean(gap[entry] for entry in discussed)
        against: list[ModelInSetting] = [entry for entry in every if gap[entry] <= 0]
        says = f"by {mean:+.2f} px over {len(discussed)} models"
        parts.append(part(f"{claim}, on average over models", mean > 0, says, True, {"mean_difference": mean}))
        says = f"{len(every) - len(against)} of {len(every)} models" + (f"; not {named(against)}" if against else "")
        parts.append(part(f"{claim}, for every model", not against, says))
    title = "Low-Light and Over Exposure are more serious than High-Light and Under Exposure respectively"
    return Observation(number=7, title=title, parts=parts)


def local_information(evidence: Evidence) -> Observation:
    """8: noise, JPEG and occluding weather cost more CRE than contrast, saturation and fog, for every model."""
    title = "Corruptions that lose local information are more influential than corruptions that lose visual effects"
    entries = [e for s in evidence.settings() for e in evidence.discussed(s) if evidence.has(e, *_LOCAL, *_VISUAL)]
    claim = "mean CRE under noise, JPEG, spatter, frost and snow is above that under contrast, saturate and fog"
    if not entries:
        return Observation(
            number=8, title=title, parts=[part(claim, None, f"needs {', '.join(_LOCAL + _VISUAL)}", True)]
        )
    local = {e: fmean(evidence.cre(e, name) for name in _LOCAL) for e in entries}
    visual = {e: fmean(evidence.cre(e, name) for name in _VISUAL) for e in entries}
    against = [e for e in entries if local[e] <= visual[e]]
    mean_local, mean_visual = fmean(local.values()), fmean(visual.values())
    says = (
        f"{mean_local:.2f} px against {mean_visual:.2f} px on average; {len(entries) - len(against)} of {len(entries)} "
        "models"
    )
    numbers = {"local": mean_local, "visual": mean_visual}
    every = [e for e in evidence.entries if evidence.has(e, "saturate", "jpeg_compression")]
    other = [e for e in every if evidence.epe(e, "saturate") >= evidence.epe(e, "jpeg_compression")]
    parts = [
        part(f"{claim}, for every model", not against, says, True, numbers),
        part(
            "saturate has a lower EPE than jpeg_compression, for every model",
            not other,
            f"{len(every) - len(other)} of {len(every)} models" + (f"; not {named(other)}" if other else ""),
        ),
    ]
    return Observation(number=8, title=title, parts=parts)
