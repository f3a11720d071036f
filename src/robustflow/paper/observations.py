"""The paper's ten observations, each checked against its results by a computation that returns a verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean, median

from ..corruptions.registry import FAMILIES
from ..report.table import Column, Table
from ..stats.model_result import ModelResult
from ..stats.published.tables import published_results
from ..stats.results import AVERAGE
from .evidence import Evidence, ModelInSetting, Observation, Statement, part, single
from .margin import Margin, among, joint, of_correlation, of_difference, of_majority, of_mean, places

_LOCAL = ("gaussian_noise", "shot_noise", "impulse_noise", "jpeg_compression", "spatter", "frost", "snow")
_VISUAL = ("contrast", "saturate", "fog")
_FLOWFORMER: ModelInSetting = ("OOD", "FlowFormer")


def observations(results: Sequence[ModelResult]) -> list[Observation]:
    """Check the paper's observations against its results (`published_results`)."""
    evidence = Evidence(results)
    return [
        Observation(number, title, list(observe(evidence)))
        for number, (title, observe) in enumerate(_OBSERVATIONS.items(), 1)
    ]


def observations_table() -> Table:
    """Tabulate the observations with the verdicts on the published results."""
    columns = ("Verdict", Column("Claim", prose=True), Column("Numbers", prose=True))
    rows = {
        f"{each.number}. {each.title}: {each.verdict}": [
            ("main" if one.main else "also", (one.verdict, one.claim, one.text)) for one in each.parts
        ]
        for each in observations(published_results())
    }
    return Table.of("observations", "The paper's observations", columns, rows, row_header="Part")


def _accuracy_and_robustness(evidence: Evidence) -> Iterable[Statement]:
    """Corrupted EPE and CRE grow with the clean EPE within each setting. CRE contains the clean EPE, so the ratio of
    the errors, which is constant if corruption multiplies all errors by one factor, is correlated too."""
    values = {"corrupted EPE": evidence.epe, "CRE": evidence.cre, "ln(EPE / clean EPE)": evidence.log_ratio}
    for name, value in values.items():
        for setting in evidence.settings:
            entries = evidence.discussed(setting)
            margin = of_correlation(evidence.by_family(entries, evidence.clean), evidence.by_family(entries, value))
            main = not name.startswith("ln")
            yield part(f"{name} grows with clean EPE ({setting}), Spearman", margin, {"models": len(entries)}, main)


def _samflow_and_csflow(evidence: Evidence) -> Iterable[Statement]:
    """The best variants of SAMFlow and CSFlow are among the three best supervised methods in EPE and CRE."""
    for setting in ("OOD", "ID"):
        for name, value in (("EPE", evidence.epe), ("CRE", evidence.cre)):
            best: dict[str, ModelInSetting] = {}
            for entry in sorted(evidence.discussed(setting, "supervised"), key=value, reverse=True):
                best[evidence.method(entry).method] = entry
            ranks = _places(evidence, best, value)
            claim = f"SAMFlow and CSFlow are among the three best in {name} ({setting})"
            verdict = among(3, [ranks["SAMFlow"], ranks["CSFlow"]])
            order = sorted(best, key=lambda family: value(best[family]))[:4]
            numbers = {family: value(best[family]) for family in order} | _rank_ends(ranks, ("SAMFlow", "CSFlow"))
            yield Statement(claim, verdict, None, numbers, True)
        sizes: list[ModelInSetting] = [(setting, f"SAMFlow-{size}") for size in "TBH"]
        for name, value in (("EPE", evidence.epe), ("CRE", evidence.cre)):
            steps = [
                of_mean([value(smaller, c) - value(larger, c) for c in evidence.corruptions], "corruption")
                for smaller, larger in (sizes[:2], sizes[1:])
            ]
            claim = f"a larger foundation model gives a lower {name}: T > B > H ({setting})"
            yield Statement(claim, joint(step.verdict for step in steps), None, {e[1]: value(e) for e in sizes})


def _unsupervised_are_stable(evidence: Evidence) -> Iterable[Statement]:
    """Unsupervised models have a lower CREr than supervised ones (ID)."""
    supervised, unsupervised = (evidence.discussed("ID", kind) for kind in ("supervised", "unsupervised"))
    worst, best = max(map(evidence.crer, unsupervised)), min(map(evidence.crer, supervised))
    crer, epe = (_gap(evidence, supervised, unsupervised, value) for value in (evidence.crer, evidence.epe))
    claim = "unsupervised models have a lower CREr than supervised ones"
    yield part(claim, crer, {"highest_unsupervised": worst, "lowest_supervised": best}, True)
    middle = median(map(evidence.epe, supervised))
    claim = "unsupervised models have a lower corrupted EPE than supervised ones"
    numbers = {"supervised_median": middle, **{entry[1]: evidence.epe(entry) for entry in unsupervised}}
    yield part(claim, epe, numbers)
    models = {entry[1]: entry for entry in unsupervised}
    ranks = [
        _places(evidence, models, value)
        for value in (evidence.cre, lambda e, c: evidence.cre(e, c) / evidence.clean(e))
    ]
    verdict = among(1, [each["ARFlow"] for each in ranks])
    numbers = {entry[1]: evidence.cre(entry) for entry in unsupervised}
    yield Statement("ARFlow has the lowest CRE and CREr of the unsupervised models", verdict, None, numbers)


def _fine_tuning_costs_robustness(evidence: Evidence) -> Iterable[Statement]:
    """The CREr of supervised models rises from OOD to ID."""
    pairs = evidence.ood_id_pairs()
    rise = {entry: evidence.crer(entry) - evidence.crer(ood) for ood, entry in pairs}
    yield from _on_average_and_mostly(evidence, "CREr rises from OOD to ID", rise, rise)
    transformers = set(evidence.discussed("ID", encoder="Transformer"))
    fall = {i: evidence.cre(o) - evidence.cre(i) for o, i in pairs if i in transformers}
    yield part("the CRE of Transformer-based models falls from OOD to ID", _mean(evidence, fall), {"models": len(fall)})


def _weather_is_why(evidence: Evidence) -> Iterable[Statement]:
    """From OOD to ID, the CREr of the Weather family rises most."""
    others = [family for family in FAMILIES if family not in ("weather", "video")]  # KITTI-FC has no video
    rises = {
        entry: {
            name: evidence.family_crer(entry)[name] - evidence.family_crer(ood)[name] for name in (*others, "weather")
        }
        for ood, entry in evidence.ood_id_pairs()
    }
    ahead = [_mean(evidence, {e: r["weather"] - r[name] for e, r in rises.items()}) for name in others]
    rising = {name: _mean(evidence, {e: r[name] for e, r in rises.items()}) for name in ("weather", *others)}
    numbers = {name: margin.estimate for name, margin in rising.items()}
    verdict = joint(margin.verdict for margin in ahead)
    yield Statement("on average over models, the CREr of Weather rises most", verdict, None, numbers, True)
    lead = {e: r["weather"] - max(value for name, value in r.items() if name != "weather") for e, r in rises.items()}
    yield _for_most(evidence, "Weather rises most", lead)
    verdict = joint(margin.verdict for margin in rising.values())
    yield Statement("CREr rises in every family of corruptions, on average over models", verdict, None, numbers)
    ood, fine_tuned = (evidence.family_crer((setting, "CSFlow")) for setting in ("OOD", "ID"))
    grown = {name: 100 * (fine_tuned[name] / ood[name] - 1) for name in ("illumination", "noise")}
    claim = "CSFlow's CREr increases by up to 291 % in Illumination and Noise"
    yield Statement(claim, "holds" if abs(max(grown.values()) - 291) < 5 else "does not hold", None, grown)


def _cost_considered(evidence: Evidence) -> Iterable[Statement]:
    """Unsupervised models have a better average rank of FLOPs and CREr (ID) than supervised ones."""
    ranks = {setting: evidence.cost_ranks["average", setting] for setting in ("OOD", "ID")}
    supervised, unsupervised = (
        [("ID", name) for name in ranks["ID"] if evidence.method(("ID", name)).type == kind]
        for kind in ("supervised", "unsupervised")
    )
    gap = _gap(evidence, supervised, unsupervised, lambda entry: float(ranks["ID"][entry[1]]))
    shown = {name: ranks["ID"][name] for _, name in unsupervised}
    best = min(ranks["ID"][name] for _, name in supervised)
    yield part("unsupervised models rank ahead of supervised ones (ID)", gap, {"best_supervised": best, **shown}, True)
    yield single("ARFlow ranks first", ARFlow=shown["ARFlow"])
    claim = "CSFlow ranks highest of the supervised models in both settings"
    yield single(claim, **{setting: ranked["CSFlow"] for setting, ranked in ranks.items()})


def _dark_and_overexposed(evidence: Evidence) -> Iterable[Statement]:
    """Averaged over models, Low-Light increases the EPE more than High-Light, and Over Exposure more than Under
    Exposure."""
    discussed = [entry for setting in evidence.settings for entry in evidence.discussed(setting)]
    for worse, milder in (("low_light", "high_light"), ("over_exposure", "under_exposure")):
        gap = {entry: evidence.epe(entry, worse) - evidence.epe(entry, milder) for entry in evidence.entries}
        claim = f"{worse} has a higher EPE than {milder}"
        yield from _on_average_and_mostly(evidence, claim, {entry: gap[entry] for entry in discussed}, gap)


def _local_information(evidence: Evidence) -> Iterable[Statement]:
    """Noise, JPEG and occluding weather cause a higher CRE than contrast, saturation and fog."""
    entries = [entry for setting in evidence.settings for entry in evidence.discussed(setting)]
    local, visual = (
        {e: fmean(evidence.cre(e, name) for name in names) for e in entries} for names in (_LOCAL, _VISUAL)
    )
    gap = {e: local[e] - visual[e] for e in entries}
    claim = "mean CRE under noise, JPEG, spatter, frost and snow is above that under contrast, saturate and fog"
    means = {"local": fmean(local.values()), "visual": fmean(visual.values())}
    yield part(claim, _mean(evidence, gap), means, True)
    yield _for_most(evidence, claim, gap)
    other = {e: evidence.epe(e, "jpeg_compression") - evidence.epe(e, "saturate") for e in evidence.entries}
    yield _for_most(evidence, "saturate has a lower EPE than jpeg_compression", other)


def _flowformer_is_best(evidence: Evidence) -> Iterable[Statement]:
    """FlowFormer has the lowest RCRE, on average and under most corruptions (GoPro-FC)."""
    rcre = evidence.rcre
    order = sorted(rcre, key=lambda entry: rcre[entry][AVERAGE])
    yield _lowest(evidence, "FlowFormer has the lowest average RCRE", _FLOWFORMER, order, True)
    names = _common(evidence, order)
    best = [name for name in names if rcre[_FLOWFORMER][name] == min(v[name] for v in rcre.values())]
    margin = of_majority(len(best), len(names), "corruption")
    yield part(
        "FlowFormer has the lowest RCRE under most corruptions", margin, {"best": len(best), "corruptions": len(names)}
    )
    cnn = [entry for entry in order if evidence.method(entry).encoder == "CNN"]
    skflow = next(entry for entry in cnn if entry[1] == "SKFlow")
    yield _lowest(evidence, "SKFlow has the lowest average RCRE of the CNN-based models", skflow, cnn)


def _foundation_model_does_not_help(evidence: Evidence) -> Iterable[Statement]:
    """SAMFlow has a higher average RCRE than FlowFormer, and is not better than the median CNN (GoPro-FC)."""
    rcre = evidence.rcre
    sam = [entry for entry in rcre if evidence.method(entry).method == "SAMFlow"]
    cnn = [entry for entry in rcre if evidence.method(entry).encoder == "CNN"]
    names = _common(evidence, [_FLOWFORMER, *sam, *cnn])
    own = {name: fmean(rcre[entry][name] for entry in sam) for name in names}
    gaps = {
        "FlowFormer, which lacks the foundation model": [own[name] - rcre[_FLOWFORMER][name] for name in names],
        "most CNN-based models": [own[name] - median(rcre[entry][name] for entry in cnn) for name in names],
    }
    best, middle = min(rcre[entry][AVERAGE] for entry in sam), median(rcre[entry][AVERAGE] for entry in cnn)
    numbers = {"best_samflow": best, "middle_cnn": middle, "FlowFormer": rcre[_FLOWFORMER][AVERAGE]}
    for than, gap in gaps.items():
        yield part(f"SAMFlow has a higher average RCRE than {than}", of_mean(gap, "corruption"), numbers, True)


_OBSERVATIONS: dict[str, Callable[[Evidence], Iterable[Statement]]] = {
    "Absolute robustness of the model depends heavily on estimation performance": _accuracy_and_robustness,
    "SAMFlow and CSFlow show remarkable estimation performance and absolute robustness among supervised models": (
        _samflow_and_csflow
    ),
    "Unsupervised methods are more stable to corruptions": _unsupervised_are_stable,
    "The relative robustness of supervised methods drop in ID scenario": _fine_tuning_costs_robustness,
    "Relative robustness drop from OOD to ID is mainly from the instability in Weather conditions": _weather_is_why,
    "After considering computing cost, unsupervised methods show the highest priority": _cost_considered,
    "Low-Light and Over Exposure are more serious than High-Light and Under Exposure respectively": (
        _dark_and_overexposed
    ),
    "Corruptions that lose local information are more influential than corruptions that lose visual effects": (
        _local_information
    ),
    "FlowFormer shows as the best robust model in small displacement condition": _flowformer_is_best,
    "VFM does not help in small displacement condition": _foundation_model_does_not_help,
}


def _mean(evidence: Evidence, values: Mapping[ModelInSetting, float]) -> Margin:
    return of_mean(evidence.by_family(values, values.__getitem__), "family")


def _gap(
    evidence: Evidence,
    larger: Sequence[ModelInSetting],
    smaller: Sequence[ModelInSetting],
    value: Callable[[ModelInSetting], float],
) -> Margin:
    return of_difference(evidence.by_family(larger, value), evidence.by_family(smaller, value))


def _on_average_and_mostly(
    evidence: Evidence, claim: str, averaged: Mapping[ModelInSetting, float], counted: Mapping[ModelInSetting, float]
) -> Iterable[Statement]:
    yield part(f"{claim}, on average over models", _mean(evidence, averaged), {"models": len(averaged)}, True)
    yield _for_most(evidence, claim, counted)


def _for_most(evidence: Evidence, claim: str, gap: Mapping[ModelInSetting, float]) -> Statement:
    """Check whether a number, averaged within each model family, is positive for most families; its numbers are those
    of the models for which it is not."""
    families = evidence.by_family(gap, gap.__getitem__)
    margin = of_majority(sum(value > 0 for value in families), len(families), "family")
    against = {" ".join(entry): value for entry, value in gap.items() if value <= 0}
    return part(f"{claim}, for most models", margin, {"models": len(gap), **against})


def _places(
    evidence: Evidence, models: Mapping[str, ModelInSetting], value: Callable[[ModelInSetting, str], float]
) -> dict[str, tuple[int, int]]:
    """Return the possible ranks of models, by name."""
    return places({name: [value(entry, c) for c in evidence.corruptions] for name, entry in models.items()})


def _rank_ends(ranks: Mapping[str, tuple[int, int]], names: Sequence[str]) -> dict[str, float]:
    ends = ("best", "worst")
    return {
        f"{end} possible rank of {name}": rank for name in names for end, rank in zip(ends, ranks[name], strict=True)
    }


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
        best.setdefault(evidence.method(other).method, other)
    own = evidence.method(entry).method
    best[own] = entry
    names = _common(evidence, list(best.values()))
    ranks = places({family: [evidence.rcre[one][name] for name in names] for family, one in best.items()})
    averages = {other[1]: evidence.rcre[other][AVERAGE] for other in order[:3]}
    return Statement(claim, among(1, [ranks[own]]), None, averages | _rank_ends(ranks, [own]), main)
