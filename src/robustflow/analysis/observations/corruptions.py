"""Observations 7 and 8: which corruptions increase the error most."""

from __future__ import annotations

from statistics import fmean

from .evidence import Evidence, ModelInSetting, named
from .margin import of_majority, of_mean
from .verdict import Observation, Statement, part

_LOCAL = ("gaussian_noise", "shot_noise", "impulse_noise", "jpeg_compression", "spatter", "frost", "snow")
_VISUAL = ("contrast", "saturate", "fog")


def dark_and_overexposed(evidence: Evidence) -> Observation:
    """Check observation 7: averaged over models, Low-Light increases the EPE more than High-Light, and Over Exposure
    more than Under Exposure."""
    parts = []
    for worse, milder in (("low_light", "high_light"), ("over_exposure", "under_exposure")):
        discussed = [entry for setting in evidence.settings() for entry in evidence.discussed(setting)]
        claim = f"{worse} has a higher EPE than {milder}"
        gap = {entry: evidence.epe(entry, worse) - evidence.epe(entry, milder) for entry in evidence.entries}
        margin = of_mean(evidence.by_family(discussed, gap.__getitem__), "family")
        message = f"by {margin.in_px} ({len(discussed)} models)"
        numbers = {"mean_difference": margin.estimate}
        parts.append(part(f"{claim}, on average over models", margin.verdict, message, True, numbers))
        parts.append(most_models(evidence, claim, gap))
    title = "Low-Light and Over Exposure are more serious than High-Light and Under Exposure respectively"
    return Observation(number=7, title=title, parts=parts)


def most_models(evidence: Evidence, claim: str, gap: dict[ModelInSetting, float]) -> Statement:
    """Check whether a number, averaged within each model family, is positive for most families, and name the models for
    which it is not."""
    against = [entry for entry, value in gap.items() if value <= 0]
    families = evidence.by_family(gap, gap.__getitem__)
    margin = of_majority(sum(value > 0 for value in families), len(families), "family")
    message = (
        f"{len(gap) - len(against)} of {len(gap)} models{f'; not {named(against)}' if against else ''}; share of "
        f"{margin.over} {100 * (0.5 + margin.estimate):.0f} % [{100 * (0.5 + margin.low):.0f} %, "
        f"{100 * (0.5 + margin.high):.0f} %]"
    )
    return part(f"{claim}, for most models", margin.verdict, message)


def local_information(evidence: Evidence) -> Observation:
    """Check observation 8: noise, JPEG and occluding weather cause a higher CRE than contrast, saturation and fog."""
    title = "Corruptions that lose local information are more influential than corruptions that lose visual effects"
    entries = [entry for setting in evidence.settings() for entry in evidence.discussed(setting)]
    claim = "mean CRE under noise, JPEG, spatter, frost and snow is above that under contrast, saturate and fog"
    local = {e: fmean(evidence.cre(e, name) for name in _LOCAL) for e in entries}
    visual = {e: fmean(evidence.cre(e, name) for name in _VISUAL) for e in entries}
    gap = {e: local[e] - visual[e] for e in entries}
    margin = of_mean(evidence.by_family(entries, gap.__getitem__), "family")
    mean_local, mean_visual = fmean(local.values()), fmean(visual.values())
    message = f"{mean_local:.2f} px against {mean_visual:.2f} px; by {margin.in_px} ({len(entries)} models)"
    other = {e: evidence.epe(e, "jpeg_compression") - evidence.epe(e, "saturate") for e in evidence.entries}
    parts = [
        part(claim, margin.verdict, message, True, {"local": mean_local, "visual": mean_visual}),
        most_models(evidence, claim, gap),
        most_models(evidence, "saturate has a lower EPE than jpeg_compression", other),
    ]
    return Observation(number=8, title=title, parts=parts)
