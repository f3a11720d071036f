"""Check Tab. 3 against the other tables: CREr from EPE and from CRE, and the ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..model_result import ModelResult, PrintedCost, Value, printed_cost_ranks, printed_costs
from ..results import AVERAGE, CLEAN
from .findings import Finding, misfits, ratio_range

_CRER_HALF = 0.005
_Part = tuple[str, int, list[Finding]]


def check_costs(results: Sequence[ModelResult]) -> list[_Part]:
    """Check the printed CREr and ranks against the other published values of the same models."""
    from_epe: list[Finding] = []
    from_cre: list[Finding] = []
    costs = printed_costs(results)
    corrected = dict(costs)
    paper = {(line.setting, line.name): line.values for line in results if line.printed_cost is not None}
    count = 0
    for name, cost in costs.items():
        for setting in ("OOD", "ID"):
            field = f"crer_{setting.lower()}"
            given, values = getattr(cost, field), paper.get((setting, name))
            if given is None or values is None:
                continue
            count += 1
            clean, epe, cre = values["epe", CLEAN], values["epe", AVERAGE], values["cre", AVERAGE]
            top = (epe.number - clean.number, epe.half + clean.half)
            misfit = _crer("crer", cost, setting, given, "EPE", top, clean)
            from_epe += misfit
            from_cre += _crer("crer_from_cre", cost, setting, given, "CRE", (cre.number, cre.half), clean)
            if misfit:
                # Printed values have two decimals, and equal printed values share a rank.
                corrected[name] = corrected[name].model_copy(update={field: round(top[0] / clean.number, 2)})
    recomputed = printed_cost_ranks(replace(line, printed_cost=corrected.get(line.name)) for line in results)
    return [
        ("crer", count, from_epe),
        ("crer_from_cre", count, from_cre),
        _ranks("rank", costs, printed_cost_ranks(results), "based on the printed values"),
        _ranks("rank_from_epe", costs, recomputed, "with inconsistent CREr recomputed from the EPE"),
    ]


def _crer(
    check: str, cost: PrintedCost, setting: str, given: float, made_of: str, top: tuple[float, float], clean: Value
) -> list[Finding]:
    ratio = top[0] / clean.number
    low, high = ratio_range(top, (clean.number, clean.half))
    tolerance = _CRER_HALF + max(high - ratio, ratio - low)
    if not misfits(given, ratio, tolerance):
        return []
    message = f"{setting} {cost.model}: CREr {given:.2f}, but its {made_of} and clean EPE imply {ratio:.3f}"
    return [_finding(check, cost, setting, (given, ratio, tolerance), message)]


def _ranks(check: str, costs: Mapping[str, PrintedCost], ranks: Mapping[str, Mapping[str, int]], how: str) -> _Part:
    count, findings = 0, []
    for field in ("flops_rank", "crer_rank_ood", "crer_rank_id", "average_rank_ood", "average_rank_id"):
        rank_values = ranks[field.replace("_rank", "")]
        setting = {"ood": "OOD", "id": "ID"}.get(field.rpartition("_")[2], "")
        what = {"flops": "FLOPs rank", "crer": "CREr rank", "average": "average rank"}[field.partition("_")[0]]
        for name, cost in costs.items():
            given = getattr(cost, field)
            if given is None or name not in rank_values:
                continue
            count += 1
            if given != rank_values[name]:
                message = f"{f'{setting} ' * bool(setting)}{name}: {what} {given}, but {how} it is {rank_values[name]}"
                findings.append(_finding(check, cost, setting, (given, rank_values[name], 0.0), message))
    return check, count, findings


def _finding(check: str, cost: PrintedCost, setting: str, numbers: tuple[float, float, float], message: str) -> Finding:
    given, recomputed, tolerance = map(float, numbers)
    return Finding(
        check=check,
        source=cost.source,
        setting=setting,
        model=cost.model,
        metric="crer",
        corruption=AVERAGE,
        given=given,
        recomputed=recomputed,
        tolerance=tolerance,
        message=message,
    )
