"""Observations 1, 2, 3 and 6: accuracy, robustness and computing cost of models."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

from .evidence import THIN, UNKNOWN, Evidence, ModelInSetting, Observation, Statement, named, part
from .margin import Margin, all_hold, among, of_correlation, of_difference, of_mean, places


def accuracy_and_robustness(evidence: Evidence) -> Observation:
    """Check observation 1: corrupted EPE and CRE grow with the clean EPE within each setting (Spearman over model
    families)."""
    parts = []
    for name, value in (("corrupted EPE", evidence.epe), ("CRE", evidence.cre)):
        for setting in evidence.settings():
            entries = evidence.discussed(setting)
            claim = f"{name} grows with clean EPE ({setting})"
            margin = of_correlation(evidence.by_family(entries, evidence.clean), evidence.by_family(entries, value))
            message = f"{setting}: Spearman {margin} ({len(entries)} models)"
            parts.append(part(claim, margin.verdict, message, True, _ends(margin, "rho")))
    parts += _uncoupled(evidence)
    return Observation(
        number=1, title="Absolute robustness of the model depends heavily on estimation performance", parts=parts
    )


def _uncoupled(evidence: Evidence) -> list[Statement]:
    """Check the same correlation for the ratio of the errors, which is constant if corruption multiplies all errors by
    the same factor."""
    parts = []
    for setting in evidence.settings():
        entries = evidence.discussed(setting)
        clean, cre, ratio = (
            evidence.by_family(entries, value) for value in (evidence.clean, evidence.cre, evidence.log_ratio)
        )
        of_cre, margin = of_correlation(clean, cre).estimate, of_correlation(clean, ratio)
        message = (
            f"{setting}: Spearman correlation with clean EPE {of_cre:+.2f} for CRE; for ln(EPE / clean EPE) {margin} "
            f"({len(entries)} models)"
        )
        claim = f"not only CRE but also the factor by which errors grow rises with clean EPE ({setting})"
        parts.append(part(claim, margin.verdict, message, numbers={"cre": of_cre, "ratio": margin.estimate}))
    message = (
        "CRE is EPE - clean EPE, so it contains the clean EPE that it is compared with: noise in the clean EPE alone "
        "causes a negative correlation, and errors that all grow by one factor cause a positive one. CRE is "
        "computed from the printed EPE here; where a printed CRE differs, both are reported"
    )
    return [*parts, part("the correlation of CRE with clean EPE is not only an arithmetic artefact", UNKNOWN, message)]


def samflow_and_csflow(evidence: Evidence) -> Observation:
    """Check observation 2: the best variants of SAMFlow and CSFlow are among the three best supervised methods in EPE
    and CRE."""
    parts = []
    for setting in ("OOD", "ID"):
        supervised = evidence.discussed(setting, "supervised")
        for name, value in (("EPE", evidence.epe), ("CRE", evidence.cre)):
            best: dict[str, ModelInSetting] = {}
            for entry in sorted(supervised, key=value, reverse=True):
                best[evidence.family(entry)] = entry
            claim = f"SAMFlow and CSFlow are among the three best in {name} ({setting})"
            order = sorted(best, key=lambda family: value(best[family]))
            text = evidence.cre_text if name == "CRE" else lambda e: f"{evidence.epe(e):.2f}"
            message = ", ".join(f"{family} {text(best[family])}" for family in order[:4])
            ranks, over = _places(evidence, best, value)
            verdict = among(3, [ranks["SAMFlow"], ranks["CSFlow"]])
            message += "; possible ranks: " + ", ".join(
                f"{family} {first} to {last}"
                for family, (first, last) in ranks.items()
                if family in ("SAMFlow", "CSFlow")
            )
            parts.append(part(claim, verdict, f"{message} {over}", True, {f: value(best[f]) for f in order}))
        parts.append(_larger_is_better(evidence, setting))
    return Observation(
        number=2,
        title="SAMFlow and CSFlow show remarkable estimation performance and absolute robustness among supervised "
        "models",
        parts=parts,
    )


def _places(
    evidence: Evidence, models: dict[str, ModelInSetting], value: Callable[[ModelInSetting, str], float]
) -> tuple[dict[str, tuple[int, int]], str]:
    """Return the possible ranks of models, by name, and a description of the tests."""
    names = evidence.corruptions()
    over = f"(paired tests over {len(names)} corruptions, corrected for all pairs of {len(models)})"
    return places({key: [value(entry, name) for name in names] for key, entry in models.items()}), over


def _larger_is_better(evidence: Evidence, setting: str) -> Statement:
    sizes: list[ModelInSetting] = [(setting, f"SAMFlow-{size}") for size in "TBH"]
    claim = f"a larger foundation model gives lower EPE and CRE: T > B > H ({setting})"
    epe, cre = [f"{evidence.epe(entry):.2f}" for entry in sizes], [evidence.cre_text(entry) for entry in sizes]
    steps = [
        of_mean([value(smaller, name) - value(larger, name) for name in evidence.corruptions()], "corruption")
        for value in (evidence.epe, evidence.cre)
        for smaller, larger in (sizes[:2], sizes[1:])
    ]
    differences = "; ".join(step.in_px for step in steps[:2])
    message = f"EPE {', '.join(epe)}; CRE {', '.join(cre)}; EPE differences T - B and B - H: {differences}"
    return part(claim, all_hold(steps), message)


def unsupervised_are_stable(evidence: Evidence) -> Observation:
    """Check observation 3: unsupervised models have a lower CREr than supervised ones (ID)."""
    supervised, unsupervised = (evidence.discussed("ID", kind) for kind in ("supervised", "unsupervised"))
    title = "Unsupervised methods are more stable to corruptions"
    claim = "unsupervised models have a lower CREr than supervised ones"
    crer, epe = (_gap(evidence, supervised, unsupervised, value) for value in (evidence.crer, evidence.epe))
    worst, best = max(map(evidence.crer, unsupervised)), min(map(evidence.crer, supervised))
    middle = median(map(evidence.epe, supervised))
    better = [entry for entry in unsupervised if evidence.epe(entry) < middle]
    parts = [
        part(
            claim,
            crer.verdict,
            f"supervised - unsupervised {crer}; highest unsupervised {worst:.2f}, lowest supervised {best:.2f}",
            True,
            {"highest_unsupervised": worst, "lowest_supervised": best},
        ),
        part(
            "unsupervised models have a lower corrupted EPE than supervised ones",
            epe.verdict,
            f"supervised - unsupervised {epe.in_px}; below the supervised median of {middle:.2f} px: {named(better)} "
            f"(out of {named(unsupervised)})",
            numbers={"supervised_median": middle},
        ),
        _lowest_of(evidence, unsupervised, "ARFlow"),
    ]
    return Observation(number=3, title=title, parts=parts)


def _gap(
    evidence: Evidence,
    larger: list[ModelInSetting],
    smaller: list[ModelInSetting],
    value: Callable[[ModelInSetting], float],
) -> Margin:
    return of_difference(evidence.by_family(larger, value), evidence.by_family(smaller, value))


def _lowest_of(evidence: Evidence, entries: list[ModelInSetting], name: str) -> Statement:
    claim = f"{name} has the lowest CRE and CREr of the unsupervised models"
    message = ", ".join(f"{e[1]} {evidence.cre(e):.2f} px, {evidence.crer(e):.2f}" for e in entries)
    models = {entry[1]: entry for entry in entries}
    ranked = [_places(evidence, models, value) for value in (evidence.cre, evidence.crer)]
    verdict = among(1, [ranks[name] for ranks, _ in ranked])
    return part(claim, verdict, f"{message} {ranked[0][1]}")


def cost_considered(evidence: Evidence) -> Observation:
    """Check observation 6: unsupervised models have a better average rank of FLOPs and CREr (ID) than supervised
    ones."""
    title = "After considering computing cost, unsupervised methods show the highest priority"
    ranks = evidence.cost_ranks
    kinds = {name: evidence.method(name).type for name in ranks["flops"]}
    groups = {
        kind: {name: rank for name, rank in ranks["average_id"].items() if kinds.get(name) == kind}
        for kind in ("supervised", "unsupervised")
    }
    claim = "unsupervised models rank ahead of supervised ones (ID)"
    supervised, unsupervised = ([("ID", name) for name in groups[kind]] for kind in ("supervised", "unsupervised"))
    gap = _gap(evidence, supervised, unsupervised, lambda entry: float(ranks["average_id"][entry[1]]))
    best = min(groups["supervised"].values())
    message = ", ".join(f"{name} {rank}" for name, rank in groups["unsupervised"].items()) + f"; best supervised {best}"
    csflow = {
        setting: {name: rank for name, rank in ranks[f"average_{setting}"].items() if kinds.get(name) == "supervised"}
        for setting in ("ood", "id")
    }
    single = "only one rank for each model, so there is no interval"
    parts = [
        part(claim, gap.verdict, f"{message}; supervised - unsupervised {gap}", True),
        part("ARFlow ranks first", THIN, f"rank {groups['unsupervised']['ARFlow']}; {single}"),
        part(
            "CSFlow ranks highest of the supervised models in both settings",
            THIN,
            ", ".join(f"{setting.upper()} {ranked['CSFlow']}" for setting, ranked in csflow.items()) + f"; {single}",
        ),
    ]
    return Observation(number=6, title=title, parts=parts)


def _ends(margin: Margin, name: str) -> dict[str, float]:
    """Return the numbers of a margin by name."""
    return {name: margin.estimate, "low": margin.low, "high": margin.high}
