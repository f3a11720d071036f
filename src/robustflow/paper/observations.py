"""The paper's ten observations, each checked against its results by a computation that returns a verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean, median

from ..corruptions.registry import FAMILIES
from ..report.table import Column, Table
from ..stats.lines import Lines
from ..stats.published.tables import published_lines
from ..stats.ranking import spearman
from ..stats.results import AVERAGE
from .evidence import Evidence, ModelInSetting, Observation, Part, Statement
from .margin import Margin, joint, of_correlation, of_difference, of_majority, of_mean, of_ranks

_LOCAL = ("gaussian_noise", "shot_noise", "impulse_noise", "jpeg_compression", "spatter", "frost", "snow")
_VISUAL = ("contrast", "saturate", "fog")
_FLOWFORMER: ModelInSetting = ("OOD", "FlowFormer")
_REMARKS = (
    "As printed: whether the paper's tables agree; CRE and CREr are computed from its EPE. Generalises: whether the "
    "95 % interval of a margin over models, families or corruptions is above 0 (yes) or below (no); -: one number of "
    "a named model. Added: not stated by the paper.",
)


def observations(lines: Lines) -> list[Observation]:
    """Check the paper's observations against its results (`published_lines`)."""
    evidence = Evidence(lines)
    return [
        Observation(number, title, list(observe(evidence)))
        for number, (title, observe) in enumerate(_OBSERVATIONS.items(), 1)
    ]


def observations_table() -> Table:
    """Tabulate the observations with the verdicts on the published results."""
    columns = [Column(label, prose=True) for label in ("Claim", "As printed", "Generalises")]
    rows = {
        observation.heading: [(part.part, part.texts) for part in observation.parts]
        for observation in observations(published_lines())
    }
    return Table.of("observations", "The paper's observations", columns, rows, _REMARKS, row_header="Part")


def _accuracy_and_robustness(evidence: Evidence) -> Iterable[Statement]:
    """Corrupted EPE and CRE grow with the clean EPE within each setting. CRE contains the clean EPE, so the ratio of
    the errors, which is constant if corruption multiplies all errors by one factor, is correlated too."""
    values = {"corrupted EPE": evidence.epe, "CRE": evidence.cre, "ln(EPE / clean EPE)": evidence.log_ratio}
    for name, value in values.items():
        for setting in evidence.settings:
            entries = evidence.discussed(setting)
            rho = spearman(map(evidence.clean, entries), map(value, entries)) or 0.0
            numbers = {"Spearman": rho, "models": len(entries)}
            margin = of_correlation(evidence.by_family(entries, evidence.clean), evidence.by_family(entries, value))
            claim = f"{name} grows with clean EPE ({setting})"
            yield Statement(claim, rho > 0, numbers, margin, "added" if name.startswith("ln") else "main")


def _samflow_and_csflow(evidence: Evidence) -> Iterable[Statement]:
    """The best variants of SAMFlow and CSFlow are among the three best supervised methods in EPE and CRE."""
    for setting in ("OOD", "ID"):
        sizes: list[ModelInSetting] = [(setting, f"SAMFlow-{size}") for size in "TBH"]
        for name, value in (("EPE", evidence.epe), ("CRE", evidence.cre)):
            order = sorted(evidence.discussed(setting, "supervised"), key=value)
            best = _best_variants(evidence, order)
            leading = {family: value(best[family]) for family in [*best][:4]}
            names = ("SAMFlow", "CSFlow")
            margin = _ranks(evidence, best, value, names, 3)
            claim = f"SAMFlow and CSFlow are among the three best in {name} ({setting})"
            yield Statement(claim, {*names} <= {*[*leading][:3]}, leading, margin, "main")
            steps = [
                of_mean([value(smaller, c) - value(larger, c) for c in evidence.corruptions], "corruption")
                for smaller, larger in (sizes[:2], sizes[1:])
            ]
            numbers = {entry[1]: value(entry) for entry in sizes}
            tiny, base, huge = numbers.values()
            claim = f"a larger foundation model gives a lower {name}: T > B > H ({setting})"
            yield Statement(claim, tiny > base > huge, numbers, joint(steps))


def _unsupervised_are_stable(evidence: Evidence) -> Iterable[Statement]:
    """Unsupervised models have a lower CREr than supervised ones (ID)."""
    supervised, unsupervised = (evidence.discussed("ID", kind) for kind in ("supervised", "unsupervised"))
    worst, best = max(map(evidence.crer, unsupervised)), min(map(evidence.crer, supervised))
    crer, epe = (_gap(evidence, supervised, unsupervised, value) for value in (evidence.crer, evidence.epe))
    numbers = {"highest unsupervised": worst, "lowest supervised": best}
    yield Statement("unsupervised models have a lower CREr than supervised ones", worst < best, numbers, crer, "main")
    middle, errors = median(map(evidence.epe, supervised)), {entry[1]: evidence.epe(entry) for entry in unsupervised}
    claim = "unsupervised models have a lower corrupted EPE than most supervised ones"
    yield Statement(claim, max(errors.values()) < middle, {"supervised median": middle} | errors, epe)
    for name, value in (("CRE", evidence.cre), ("CREr", evidence.crer)):
        numbers = {entry[1]: value(entry) for entry in sorted(unsupervised, key=value)}
        margin = _ranks(evidence, {entry[1]: entry for entry in unsupervised}, value, ["ARFlow"], 1)
        claim = f"ARFlow has the lowest {name} of the unsupervised models"
        yield Statement(claim, next(iter(numbers)) == "ARFlow", numbers, margin)


def _fine_tuning_costs_robustness(evidence: Evidence) -> Iterable[Statement]:
    """The CREr of supervised models rises from OOD to ID."""
    pairs = evidence.ood_id_pairs()
    rise = {entry: evidence.crer(entry) - evidence.crer(ood) for ood, entry in pairs}
    yield _on_average(evidence, "CREr rises from OOD to ID", rise)
    yield _mostly(evidence, "CREr rises from OOD to ID", rise, every=True)
    transformers = set(evidence.discussed("ID", encoder="Transformer"))
    fall = {i: evidence.cre(o) - evidence.cre(i) for o, i in pairs if i in transformers}
    printed, numbers = _exceptions(fall)
    claim = "the CRE of Transformer-based models falls from OOD to ID"
    yield Statement(claim, printed, numbers, _mean(evidence, fall))


def _weather_is_why(evidence: Evidence) -> Iterable[Statement]:
    """From OOD to ID, the CREr of the Weather family rises most."""
    others = [family for family in FAMILIES if family not in ("weather", "video")]  # KITTI-FC has no video
    rises = {
        entry: {
            name: evidence.family_crer(entry)[name] - evidence.family_crer(ood)[name] for name in ("weather", *others)
        }
        for ood, entry in evidence.ood_id_pairs()
    }
    ahead = [_mean(evidence, {e: r["weather"] - r[name] for e, r in rises.items()}) for name in others]
    rising = [_mean(evidence, {e: r[name] for e, r in rises.items()}) for name in ("weather", *others)]
    means = {name: fmean(r[name] for r in rises.values()) for name in ("weather", *others)}
    most = means["weather"] == max(means.values())
    yield Statement("on average over models, the CREr of Weather rises most", most, means, joint(ahead), "main")
    lead = {e: r["weather"] - max(value for name, value in r.items() if name != "weather") for e, r in rises.items()}
    yield _mostly(evidence, "Weather rises most", lead)
    claim = "CREr rises in every family of corruptions, on average over models"
    yield Statement(claim, min(means.values()) > 0, means, joint(rising))
    ood, fine_tuned = (evidence.family_crer((setting, "CSFlow")) for setting in ("OOD", "ID"))
    grown = {name: 100 * (fine_tuned[name] / ood[name] - 1) for name in ("illumination", "noise")}
    claim = "CSFlow's CREr increases by up to 291 % in Illumination and Noise"
    yield Statement(claim, abs(max(grown.values()) - 291) < 5, grown)


def _cost_considered(evidence: Evidence) -> Iterable[Statement]:
    """Unsupervised models have a better average rank of FLOPs and CREr (ID) than supervised ones."""
    ranks = {setting: evidence.cost_ranks["average", setting] for setting in ("OOD", "ID")}
    supervised, unsupervised = (
        [("ID", name) for name in ranks["ID"] if evidence.method(("ID", name)).type == kind]
        for kind in ("supervised", "unsupervised")
    )
    gap = _gap(evidence, supervised, unsupervised, lambda entry: float(ranks["ID"][entry[1]]))
    shown = {name: ranks["ID"][name] for _, name in unsupervised}
    best = {setting: min(ranked[name] for _, name in supervised) for setting, ranked in ranks.items()}
    ahead, numbers = max(shown.values()) < best["ID"], {"best supervised": best["ID"], **shown}
    yield Statement("unsupervised models rank ahead of supervised ones (ID)", ahead, numbers, gap, "main")
    first = {"ARFlow": shown["ARFlow"]}
    yield Statement("ARFlow ranks first", shown["ARFlow"] == 1, first)
    of_csflow = {setting: ranked["CSFlow"] for setting, ranked in ranks.items()}
    claim = "CSFlow ranks highest of the supervised models in both settings"
    yield Statement(claim, of_csflow == best, of_csflow)


def _dark_and_overexposed(evidence: Evidence) -> Iterable[Statement]:
    """Averaged over models, Low-Light increases the EPE more than High-Light, and Over Exposure more than Under
    Exposure."""
    discussed = [entry for setting in evidence.settings for entry in evidence.discussed(setting)]
    for worse, milder in (("low_light", "high_light"), ("over_exposure", "under_exposure")):
        gap = {entry: evidence.epe(entry, worse) - evidence.epe(entry, milder) for entry in evidence.entries}
        claim = f"{worse} has a higher EPE than {milder}"
        yield _on_average(evidence, claim, {entry: gap[entry] for entry in discussed})
        yield _mostly(evidence, claim, gap, every=worse == "low_light")


def _local_information(evidence: Evidence) -> Iterable[Statement]:
    """Noise, JPEG and occluding weather cause a higher CRE than contrast, saturation and fog."""
    entries = [entry for setting in evidence.settings for entry in evidence.discussed(setting)]
    local, visual = (
        {e: fmean(evidence.cre(e, name) for name in names) for e in entries} for names in (_LOCAL, _VISUAL)
    )
    gap = {e: local[e] - visual[e] for e in entries}
    claim = "mean CRE under noise, JPEG, spatter, frost and snow is above that under contrast, saturate and fog"
    yield _on_average(evidence, claim, gap)
    yield _mostly(evidence, claim, gap)
    other = {e: evidence.epe(e, "jpeg_compression") - evidence.epe(e, "saturate") for e in evidence.entries}
    yield _mostly(evidence, "saturate has a lower EPE than jpeg_compression", other, every=True)


def _flowformer_is_best(evidence: Evidence) -> Iterable[Statement]:
    """FlowFormer has the lowest RCRE, on average and under most corruptions (GoPro-FC)."""
    rcre = evidence.rcre
    order = sorted(rcre, key=lambda entry: rcre[entry][AVERAGE])
    yield _lowest(evidence, "FlowFormer has the lowest average RCRE", _FLOWFORMER, order, "main")
    names = _common(evidence, order)
    best = [name for name in names if rcre[_FLOWFORMER][name] == min(v[name] for v in rcre.values())]
    margin = of_majority(len(best), len(names), "corruption")
    numbers = {"lowest": len(best), "corruptions": len(names)}
    claim = "FlowFormer has the lowest RCRE under most corruptions"
    yield Statement(claim, 2 * len(best) > len(names), numbers, margin)
    cnn = [entry for entry in order if evidence.method(entry).encoder == "CNN"]
    skflow = next(entry for entry in cnn if entry[1] == "SKFlow")
    yield _lowest(evidence, "SKFlow has the lowest average RCRE of the CNN-based models", skflow, cnn)


def _foundation_model_does_not_help(evidence: Evidence) -> Iterable[Statement]:
    """SAMFlow has a higher average RCRE than FlowFormer, and is not better than the median CNN (GoPro-FC)."""
    rcre = evidence.rcre
    sam = [entry for entry in rcre if evidence.method(entry).method == "SAMFlow"]
    cnn = [entry for entry in rcre if evidence.method(entry).encoder == "CNN"]
    names = _common(evidence, [_FLOWFORMER, *sam, *cnn])
    mean = {name: fmean(rcre[entry][name] for entry in sam) for name in (AVERAGE, *names)}
    middle = {name: median(rcre[entry][name] for entry in cnn) for name in (AVERAGE, *names)}
    for than, others in {
        "FlowFormer, which lacks the foundation model": rcre[_FLOWFORMER],
        "most CNN-based models": middle,
    }.items():
        margin = of_mean([mean[name] - others[name] for name in names], "corruption")
        numbers = {"SAMFlow": mean[AVERAGE], than.partition(",")[0].replace("most", "median of"): others[AVERAGE]}
        claim = f"SAMFlow has a higher average RCRE than {than}"
        yield Statement(claim, mean[AVERAGE] > others[AVERAGE], numbers, margin, "main")


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


def _on_average(evidence: Evidence, claim: str, gap: Mapping[ModelInSetting, float]) -> Statement:
    """Check whether the mean of a number over models is positive."""
    numbers = {"mean": fmean(gap.values()), "models": len(gap)}
    return Statement(f"{claim}, on average over models", numbers["mean"] > 0, numbers, _mean(evidence, gap), "main")


def _mostly(evidence: Evidence, claim: str, gap: Mapping[ModelInSetting, float], every: bool = False) -> Statement:
    """Check whether a number is positive for most (or all) models, and, averaged within each family, for most
    families."""
    families = evidence.by_family(gap, gap.__getitem__)
    margin = of_majority(sum(value > 0 for value in families), len(families), "family")
    for_all, numbers = _exceptions(gap)
    printed = for_all if every else 2 * numbers["exceptions"] < len(gap)
    return Statement(f"{claim}, for {'all' if every else 'most'} models", printed, numbers, margin)


def _exceptions(gap: Mapping[ModelInSetting, float]) -> tuple[bool, dict[str, float]]:
    """Return whether all numbers are positive, and those that are not, with their count."""
    against = {" ".join(entry): value for entry, value in gap.items() if value <= 0}
    return not against, {"exceptions": len(against), "models": len(gap), **against}


def _best_variants(evidence: Evidence, order: Iterable[ModelInSetting]) -> dict[str, ModelInSetting]:
    """Return the first model of each family."""
    best: dict[str, ModelInSetting] = {}
    for entry in order:
        best.setdefault(evidence.method(entry).method, entry)
    return best


def _ranks(
    evidence: Evidence,
    models: Mapping[str, ModelInSetting],
    value: Callable[[ModelInSetting, str], float],
    names: Sequence[str],
    best: int,
) -> Margin:
    values = {name: [value(entry, c) for c in evidence.corruptions] for name, entry in models.items()}
    return of_ranks(values, names, best)


def _common(evidence: Evidence, entries: Sequence[ModelInSetting]) -> list[str]:
    """List the corruptions under which all of these models were measured."""
    first, *others = (evidence.rcre[entry] for entry in entries)
    return [name for name in first if name != AVERAGE and all(name in values for values in others)]


def _lowest(
    evidence: Evidence, claim: str, entry: ModelInSetting, order: Sequence[ModelInSetting], part: Part = "also"
) -> Statement:
    """Check whether a model has the lowest RCRE among the best models of all families, listed in `order` by their
    average."""
    family = evidence.method(entry).method
    best = _best_variants(evidence, order) | {family: entry}
    names = _common(evidence, list(best.values()))
    margin = of_ranks({name: [evidence.rcre[of][c] for c in names] for name, of in best.items()}, [family], 1)
    averages = {other[1]: evidence.rcre[other][AVERAGE] for other in order[:3]}
    return Statement(claim, order[0] == entry, averages, margin, part)
