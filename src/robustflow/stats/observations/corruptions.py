"""Observations 7 and 8: which corruptions increase the error most. Observations 4 and 5: how training on the
benchmark's domain (OOD to ID) changes a model's robustness.
"""

from __future__ import annotations

from statistics import fmean

from ...corruptions.registry import FAMILIES
from .evidence import Evidence, ModelInSetting, Observation, Statement, Verdict, named, part
from .margin import Margin, all_hold, of_majority, of_mean

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


def fine_tuning_costs_robustness(evidence: Evidence) -> Observation:
    """Check observation 4: the CREr of supervised models rises from OOD to ID."""
    pairs = _ood_id_pairs(evidence)
    title = "The relative robustness of supervised methods drop in ID scenario"
    claim = "CREr rises from OOD to ID"
    rise = {entry: evidence.crer(entry) - evidence.crer(ood) for ood, entry in pairs}
    margin = _mean(evidence, rise)
    least = min(pairs, key=lambda pair: rise[pair[1]])
    message = (
        f"by {margin} ({len(pairs)} models); least for {least[1][1]}, {evidence.crer(least[0]):.2f} to "
        f"{evidence.crer(least[1]):.2f}"
    )
    transformers = set(evidence.discussed("ID", encoder="Transformer"))
    fall = {i: evidence.cre(o) - evidence.cre(i) for o, i in pairs if i in transformers}
    falls = _mean(evidence, fall)
    parts = [
        part(f"{claim}, on average over supervised models", margin.verdict, message, True, {"models": len(pairs)}),
        most_models(evidence, claim, rise),
        part(
            "the CRE of Transformer-based models falls from OOD to ID",
            falls.verdict,
            f"by {falls.in_px} ({sum(value > 0 for value in fall.values())} of {len(fall)} models)",
        ),
    ]
    return Observation(number=4, title=title, parts=parts)


def weather_is_why(evidence: Evidence) -> Observation:
    """Check observation 5: from OOD to ID, the CREr of the Weather family rises most."""
    pairs = _ood_id_pairs(evidence)
    title = "Relative robustness drop from OOD to ID is mainly from the instability in Weather conditions"
    others = [family for family in FAMILIES if family not in ("weather", "video")]  # KITTI-FC has no video
    rises = {
        entry: {
            family: evidence.family_crer(entry, family) - evidence.family_crer(ood, family)
            for family in (*others, "weather")
        }
        for ood, entry in pairs
    }
    mean = {name: fmean(of_model[name] for of_model in rises.values()) for name in ("weather", *others)}
    ahead = {name: _mean(evidence, {e: r["weather"] - r[name] for e, r in rises.items()}) for name in others}
    rising = {name: _mean(evidence, {e: r[name] for e, r in rises.items()}) for name in mean}
    lead = {
        entry: r["weather"] - max(value for name, value in r.items() if name != "weather") for entry, r in rises.items()
    }
    parts = [
        part(
            "on average over models, the CREr of Weather rises most",
            all_hold(list(ahead.values())),
            ", ".join(f"{name} {rise:+.2f}" for name, rise in mean.items())
            + "; Weather minus "
            + "; minus ".join(f"{name} {margin}" for name, margin in ahead.items()),
            True,
            mean,
        ),
        most_models(evidence, "Weather rises most", lead),
        part(
            "CREr rises in every family of corruptions, on average over models",
            all_hold(list(rising.values())),
            "; ".join(f"{name} {margin}" for name, margin in rising.items()),
        ),
    ]
    return Observation(number=5, title=title, parts=[*parts, _csflow_increase(evidence)])


def _mean(evidence: Evidence, values: dict[ModelInSetting, float]) -> Margin:
    return of_mean(evidence.by_family(values, values.__getitem__), "family")


def _csflow_increase(evidence: Evidence) -> Statement:
    """Recompute a number that the paper states. The verdict depends on arithmetic only, so there is no interval."""
    increase = {
        family: 100
        * (evidence.family_crer(("ID", "CSFlow"), family) / evidence.family_crer(("OOD", "CSFlow"), family) - 1)
        for family in ("illumination", "noise")
    }
    largest = max(increase.values())
    message = "CREr grows by " + ", ".join(f"{value:.0f} % ({family})" for family, value in increase.items())
    message += f", to {largest + 100:.0f} % of its OOD value"
    claim = "CSFlow's CREr increases by up to 291 % in Illumination and Noise"
    verdict: Verdict = "holds" if abs(largest - 291) < 5 else "does not hold"
    return part(claim, verdict, message, numbers=increase)


def _ood_id_pairs(evidence: Evidence) -> list[tuple[ModelInSetting, ModelInSetting]]:
    """Return the (OOD, ID) pair of every supervised model that was measured in both settings."""
    ood = set(evidence.discussed("OOD", "supervised"))
    return [(("OOD", m), (s, m)) for s, m in evidence.discussed("ID", "supervised") if ("OOD", m) in ood]
