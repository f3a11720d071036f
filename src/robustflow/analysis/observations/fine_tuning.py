"""Observations 4 and 5: what training on the benchmark's own domain (OOD to ID) does to a model's robustness."""

from __future__ import annotations

from statistics import fmean

from ...corruptions.registry import FAMILIES
from .evidence import Evidence, ModelInSetting, named
from .verdict import Observation, Statement, part


def fine_tuning_costs_robustness(evidence: Evidence) -> Observation:
    """4: the CREr of every supervised model rises from OOD to ID."""
    pairs = _both_settings(evidence)
    title = "The relative robustness of supervised methods drop in ID scenario"
    if not pairs:
        claim = "CREr rises from OOD to ID for every supervised model"
        return Observation(number=4, title=title, parts=[part(claim, None, "needs models in both settings", True)])
    fallen = [entry for ood, entry in pairs if evidence.crer(entry) <= evidence.crer(ood)]
    transformers = [(o, i) for o, i in pairs if i in evidence.discussed("ID", encoder="Transformer")]
    grown = [i for o, i in transformers if evidence.cre(i) >= evidence.cre(o)]
    least = min(pairs, key=lambda pair: evidence.crer(pair[1]) - evidence.crer(pair[0]))
    says = (
        f"{len(pairs) - len(fallen)} of {len(pairs)} models; least for {least[1][1]}, {evidence.crer(least[0]):.2f} to "
        f"{evidence.crer(least[1]):.2f}"
    )
    parts = [
        part("CREr rises from OOD to ID for every supervised model", not fallen, says, True, {"models": len(pairs)}),
        part(
            "the CRE of Transformer-based models falls from OOD to ID",
            not grown if transformers else None,
            f"{len(transformers) - len(grown)} of {len(transformers)} models",
        ),
    ]
    return Observation(number=4, title=title, parts=parts)


def weather_is_why(evidence: Evidence) -> Observation:
    """5: from OOD to ID the CREr of the Weather family rises most, for every supervised model."""
    pairs = _both_settings(evidence)
    title = "Relative robustness drop from OOD to ID is mainly from the instability in Weather conditions"
    rises: dict[str, dict[str, float]] = {}
    for ood, entry in pairs:
        for family in FAMILIES:
            before, after = evidence.family_crer(ood, family), evidence.family_crer(entry, family)
            if before is not None and after is not None:
                rises.setdefault(entry[1], {})[family] = after - before
    rises = {model: families for model, families in rises.items() if "weather" in families and len(families) > 1}
    if not rises:
        claim = "Weather rises most for every supervised model"
        return Observation(number=5, title=title, parts=[part(claim, None, "needs models in both settings", True)])
    others = {model: max(f, key=f.__getitem__) for model, f in rises.items() if max(f, key=f.__getitem__) != "weather"}
    mean = {family: fmean(f[family] for f in rises.values()) for family in next(iter(rises.values()))}
    falls = [(model, family) for model, families in rises.items() for family, rise in families.items() if rise <= 0]
    parts = [
        part(
            "on average over models, the CREr of Weather rises most",
            max(mean, key=mean.__getitem__) == "weather",
            ", ".join(f"{family} {rise:+.2f}" for family, rise in mean.items()),
            True,
            mean,
        ),
        part(
            "Weather rises most for every supervised model",
            not others,
            f"{len(rises) - len(others)} of {len(rises)} models; not " + named(list(others.items()))
            if others
            else f"{len(rises)} models",
        ),
        part(
            "CREr rises in every family for every supervised model",
            not falls,
            f"it falls for {named(falls)}" if falls else f"{len(rises)} models",
        ),
    ]
    return Observation(number=5, title=title, parts=[*parts, *_csflow_increase(evidence)])


def _csflow_increase(evidence: Evidence) -> list[Statement]:
    ood, entry = ("OOD", "CSFlow"), ("ID", "CSFlow")
    if not {ood, entry} <= set(evidence.entries):
        return []
    increase = {}
    for family in ("illumination", "noise"):
        before, after = evidence.family_crer(ood, family), evidence.family_crer(entry, family)
        if before and after is not None:
            increase[family] = 100 * (after / before - 1)
    if not increase:
        return []
    largest = max(increase.values())
    says = "CREr grows by " + ", ".join(f"{value:.0f} % ({family})" for family, value in increase.items())
    says += f", to {largest + 100:.0f} % of its OOD value"
    claim = "CSFlow's CREr increases by up to 291 % in Illumination and Noise"
    return [part(claim, abs(largest - 291) < 5, says, numbers=increase)]


def _both_settings(evidence: Evidence) -> list[tuple[ModelInSetting, ModelInSetting]]:
    """(OOD, ID) of every supervised model that was measured in both."""
    ood = set(evidence.discussed("OOD", "supervised"))
    return [(("OOD", m), (s, m)) for s, m in evidence.discussed("ID", "supervised") if ("OOD", m) in ood]
