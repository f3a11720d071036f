"""Observations 1, 2, 3 and 6: accuracy and robustness of models, and what they cost."""

from __future__ import annotations

from statistics import median

from ..cost_ranks import cost_ranks
from ..rank_correlation import p_of_growth, spearman
from ..uncertainty.sentences import p_text
from ..uncoupled import coupling
from .evidence import Evidence, ModelInSetting, named
from .verdict import Observation, Statement, part

_LEAST = 5
"""Smallest number of models for which a correlation is meaningful."""


def accuracy_and_robustness(evidence: Evidence) -> Observation:
    """1: corrupted EPE and CRE grow with the clean EPE, setting by setting (Spearman, one-sided p < 0.05)."""
    parts = []
    settings = [setting for setting in evidence.settings() if len(evidence.discussed(setting)) >= _LEAST]
    for name, value in (("corrupted EPE", evidence.epe), ("CRE", evidence.cre)):
        for setting in settings:
            entries = evidence.discussed(setting)
            columns = [evidence.clean(e) for e in entries], [value(e) for e in entries]
            if any(len(set(column)) == 1 for column in columns):
                says = f"{setting}: all models have the same clean EPE or {name}, so there is no correlation"
                parts.append(part(f"{name} grows with clean EPE ({setting})", None, says, True))
                continue
            rho = spearman(*columns)
            assert rho is not None  # both columns vary
            p = p_of_growth(rho, len(entries))
            says = f"{setting}: Spearman {rho:+.2f}, one-sided p {p_text(p)}, {len(entries)} models"
            parts.append(part(f"{name} grows with clean EPE ({setting})", p < 0.05, says, True, {"rho": rho, "p": p}))
    if not parts:
        parts.append(part("corrupted EPE and CRE grow with clean EPE", None, f"needs {_LEAST} models", True))
    parts += _uncoupled(evidence, settings)
    return Observation(
        number=1, title="Absolute robustness of the model depends heavily on estimation performance", parts=parts
    )


def _uncoupled(evidence: Evidence, settings: list[str]) -> list[Statement]:
    """The same correlation for the ratio of the errors, which does not grow where corruption multiplies every error."""
    parts = []
    for setting in settings:
        entries = [e for e in evidence.discussed(setting) if evidence.clean(e) > 0 < evidence.epe(e)]
        clean, cre, ratio = (
            [value(e) for e in entries] for value in (evidence.clean, evidence.cre, evidence.log_ratio)
        )
        correlation = coupling(clean, cre, ratio)
        if correlation is not None and correlation.cre is not None and correlation.log_ratio is not None:
            p = p_of_growth(correlation.log_ratio, correlation.models)
            says = (
                f"{setting}: Spearman with clean EPE {correlation.cre:+.2f} for CRE, {correlation.log_ratio:+.2f} for "
                f"ln(EPE / clean EPE), one-sided p {p_text(p)}, {correlation.models} models"
            )
            claim = f"not only CRE but also the factor by which errors grow rises with clean EPE ({setting})"
            parts.append(part(claim, p < 0.05, says, numbers={"cre": correlation.cre, "ratio": correlation.log_ratio}))
    says = (
        "CRE is EPE - clean EPE, so it contains the clean EPE that it is compared with: noise in the clean EPE alone "
        "makes a correlation, of the other sign, and errors that all grow by one factor make one of this sign. CRE is "
        "made from the printed EPE here; where a printed CRE differs, both are given"
    )
    return [*parts, part("the correlation of CRE with clean EPE is not arithmetic alone", None, says)]


def samflow_and_csflow(evidence: Evidence) -> Observation:
    """2: SAMFlow and CSFlow are among the three best supervised methods (best variant each) in EPE and CRE."""
    parts = []
    for setting in ("OOD", "ID"):
        supervised = evidence.discussed(setting, "supervised")
        for name, value in (("EPE", evidence.epe), ("CRE", evidence.cre)):
            best: dict[str, float] = {}
            for entry in supervised:
                key = _method_name(evidence, entry)
                best[key] = min(value(entry), best.get(key, float("inf")))
            claim = f"SAMFlow and CSFlow are among the three best in {name} ({setting})"
            if not {"SAMFlow", "CSFlow"} <= best.keys():
                parts.append(part(claim, None, "SAMFlow or CSFlow is not among the models", True))
                continue
            order = sorted(best, key=best.__getitem__)
            entry_of = {_method_name(evidence, e): e for e in sorted(supervised, key=value, reverse=True)}
            text = evidence.cre_text if name == "CRE" else lambda e: f"{evidence.epe(e):.2f}"
            says = ", ".join(f"{key} {text(entry_of[key])}" for key in order[:4])
            parts.append(part(claim, {"SAMFlow", "CSFlow"} <= set(order[:3]), says, True, {k: best[k] for k in order}))
        parts += _larger_is_better(evidence, setting)
    return Observation(
        number=2,
        title="SAMFlow and CSFlow show remarkable estimation performance and absolute robustness among supervised "
        "models",
        parts=parts,
    )


def _method_name(evidence: Evidence, entry: ModelInSetting) -> str:
    """The common name of a method's variants; the model's name if that is unknown."""
    method = evidence.method(entry[1])
    return method.method if method else entry[1]


def _larger_is_better(evidence: Evidence, setting: str) -> list[Statement]:
    sizes: list[ModelInSetting] = [(setting, f"SAMFlow-{size}") for size in "TBH"]
    claim = f"a larger foundation model gives lower EPE and CRE: T > B > H ({setting})"
    if not set(sizes) <= set(evidence.entries):
        return [part(claim, None, "not all three sizes of SAMFlow are among the models")]
    epe, cre = ([value(entry) for entry in sizes] for value in (evidence.epe, evidence.cre))
    holds = epe[0] > epe[1] > epe[2] and cre[0] > cre[1] > cre[2]
    texts = [f"{v:.2f}" for v in epe], [evidence.cre_text(entry) for entry in sizes]
    shown = ((" > " if holds else ", ").join(each) for each in texts)
    return [part(claim, holds, "EPE {}; CRE {}".format(*shown))]


def unsupervised_are_stable(evidence: Evidence) -> Observation:
    """3: every unsupervised model has a lower CREr than every supervised one (ID)."""
    supervised, unsupervised = (evidence.discussed("ID", kind) for kind in ("supervised", "unsupervised"))
    title = "Unsupervised methods are more stable to corruptions"
    if not supervised or not unsupervised:
        claim = "every unsupervised CREr is below every supervised one"
        return Observation(number=3, title=title, parts=[part(claim, None, "needs both kinds of models in ID", True)])
    worst, best = max(map(evidence.crer, unsupervised)), min(map(evidence.crer, supervised))
    middle = median(map(evidence.epe, supervised))
    better = [entry for entry in unsupervised if evidence.epe(entry) < middle]
    arflow: ModelInSetting = ("ID", "ARFlow")
    first = all(min(unsupervised, key=value) == arflow for value in (evidence.cre, evidence.crer))
    parts = [
        part(
            "every unsupervised CREr is below every supervised one",
            worst < best,
            f"highest unsupervised {worst:.2f}, lowest supervised {best:.2f}",
            True,
            {"highest_unsupervised": worst, "lowest_supervised": best},
        ),
        part(
            "unsupervised models have a lower corrupted EPE than most supervised models",
            len(better) == len(unsupervised),
            f"below the supervised median of {middle:.2f} px: {named(better)} of {named(unsupervised)}",
            numbers={"supervised_median": middle},
        ),
        part(
            "ARFlow has the lowest CRE and CREr of them",
            first if arflow in unsupervised else None,
            ", ".join(f"{e[1]} {evidence.cre(e):.2f} px, {evidence.crer(e):.2f}" for e in unsupervised),
        ),
    ]
    return Observation(number=3, title=title, parts=parts)


def cost_considered(evidence: Evidence) -> Observation:
    """6: in average rank of FLOPs and CREr (ID), every unsupervised model is ahead of every supervised one."""
    title = "After considering computing cost, unsupervised methods show the highest priority"
    ranks = cost_ranks(evidence.costs) if evidence.costs else {}
    kinds = {name: method.type for name in evidence.costs if (method := evidence.method(name)) is not None}
    groups = {
        kind: {name: rank for name, rank in ranks.get("average_id", {}).items() if kinds.get(name) == kind}
        for kind in ("supervised", "unsupervised")
    }
    claim = "every unsupervised model ranks ahead of every supervised one (ID)"
    if not all(groups.values()):
        return Observation(number=6, title=title, parts=[part(claim, None, "needs FLOPs and CREr of both kinds", True)])
    worst, best = max(groups["unsupervised"].values()), min(groups["supervised"].values())
    says = ", ".join(f"{name} {rank}" for name, rank in groups["unsupervised"].items()) + f"; best supervised {best}"
    first = groups["unsupervised"].get("ARFlow")
    csflow = {
        setting: {name: rank for name, rank in ranks[f"average_{setting}"].items() if kinds.get(name) == "supervised"}
        for setting in ("ood", "id")
    }
    known = [ranked for ranked in csflow.values() if "CSFlow" in ranked]
    parts = [
        part(claim, worst < best, says, True),
        part("ARFlow ranks first", None if first is None else first == 1, f"rank {first}"),
        part(
            "CSFlow ranks highest of the supervised models in both settings",
            all(ranked["CSFlow"] == min(ranked.values()) for ranked in known) if known else None,
            ", ".join(f"{setting.upper()} {ranked.get('CSFlow', '-')}" for setting, ranked in csflow.items()),
        ),
    ]
    return Observation(number=6, title=title, parts=parts)
