"""The hypotheses of the experiment, specified before any network was trained. Report the results of the experiment
as Markdown text and tables; every claim is supported by an interval.

For each seed, one network is trained from random weights without corruptions. Each arm continues training from this
network with its corruptions; "plain" uses none. There is one hypothesis for each of the two held-out families: compared
with training without corruptions, training with all other families changes the error caused by the held-out family
(CRE, mean over the family's corruptions, severity 3). Both hypotheses are tested two-sided on held-out flying shapes,
over pairs and seeds, with Holm's correction for two tests at the 5 % level. RCRE is secondary; all other results (EPE,
CREr, clean EPE, single corruptions, the arm trained with all families) are descriptive.

A seed is excluded with all its arms in only two cases: if one of its networks has not been trained, or if the clean
error of one of them is not below half the error of zero flow, which means that the network has not learned to match.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl
from scipy.special import stdtrit

from ...core.text import counted
from ...data.datasets import dataset_facts
from ...metrics.rows import CLEAN
from ...stats.uncertainty.paired import holm
from .effects import ALL, FEWEST_PAIRS, FEWEST_SEEDS, LEFT_OUT, Runs, effects, left_out


@dataclass(frozen=True)
class Hypothesis:
    """The hypothesis that training with all families except one changes an error under the held-out family."""

    family: str
    quantity: str = "cre"

    @property
    def arm(self) -> str:
        """Return the arm that is compared with training without corruptions."""
        return f"no_{self.family}"


PRIMARY = tuple(Hypothesis(family) for family in LEFT_OUT)
SECONDARY = tuple(Hypothesis(family, "rcre") for family in LEFT_OUT)
DATASET = "shapes"
"""Dataset on which the hypotheses are tested."""
LEVEL = 0.05
"""Joint significance level of the two primary tests."""


_POWER = 0.8


def findings(runs: Runs) -> tuple[str, pl.DataFrame]:
    """Return the page, and a table of all effects (see `effects`)."""
    parts, tables = [], []
    for dataset in dict.fromkeys(of for _, of, _ in runs):
        pairs = len(set(next(run for (_, of, _), run in runs.items() if of == dataset).rows["sample"]))
        excluded = left_out(runs, dataset)
        seeds = sorted({seed for _, of, seed in runs if of == dataset} - excluded.keys())
        parts.append(f"## {dataset_facts(dataset).title}: {counted(pairs, 'pair')}, {counted(len(seeds), 'seed')}")
        parts += [f"Seed {seed} is left out ({reason})." for seed, reason in excluded.items()]
        if not seeds:
            parts.append("No seeds are left to compare.")
            continue
        table = effects(runs, dataset, seeds)
        tables.append(table)
        if dataset == DATASET:
            parts += [_hypotheses(table, PRIMARY), _hypotheses(table, SECONDARY)]
        parts += [_families(table), _clean(table)]
    return "\n\n".join(parts) + "\n", pl.concat(tables) if tables else pl.DataFrame()


def _hypotheses(table: pl.DataFrame, hypotheses: Sequence[Hypothesis]) -> str:
    """Return one sentence per hypothesis, with Holm's correction for all of them."""
    tested = [_single_row(table, each.arm, each.family, each.quantity) for each in hypotheses]
    if any(effect["p"] is None for effect in tested):
        few = f"With fewer than {FEWEST_SEEDS} seeds or {FEWEST_PAIRS} pairs there is no test"
        values = (f"{_named(each)} {_change(effect)} px" for each, effect in zip(hypotheses, tested, strict=True))
        return f"{few}: {'; '.join(values)}."
    adjusted = holm([effect["p"] for effect in tested])
    lines = []
    for each, effect, p in zip(hypotheses, tested, adjusted, strict=True):
        verdict = "the change is not significantly different from zero"
        if p < LEVEL:
            verdict = "it decreases" if effect["difference"] < 0 else "it increases"
        lines.append(
            f"- {_named(each)} {_change(effect)} px, difference {_difference(effect)}, p = {p:.3f} after Holm's "
            f"correction for {len(hypotheses)} tests: {verdict}. The probability of detecting a change of "
            f"{_detectable(effect):.2f} px is {100 * _POWER:.0f} %."
        )
    return "\n".join(lines)


def _named(hypothesis: Hypothesis) -> str:
    return f"{hypothesis.quantity.upper()} under {hypothesis.family}, which was left out of training:"


def _change(effect: dict[str, Any]) -> str:
    return f"{effect['plain']:.2f} to {effect['value']:.2f}"


def _detectable(effect: dict[str, Any]) -> float:
    """Return the difference that two tests at half the level detect with the given power, assuming the same standard
    error."""
    return float(sum(stdtrit(effect["freedom"], level) for level in (1 - LEVEL / 4, _POWER)) * effect["error"])


def _families(table: pl.DataFrame) -> str:
    names = [*("EPE plain", "EPE", "difference"), *("CRE plain", "CRE", "difference"), "CREr plain", "CREr"]
    names += ["RCRE plain", "RCRE", "difference"]
    lines = [f"| under | | {' | '.join(names)} |", "|---|---|" + "---:|" * len(names)]
    for family in LEFT_OUT:
        for arm, word in ((f"no_{family}", "not trained with it"), (ALL, "trained with all")):
            cells = [family, word]
            for quantity in ("epe", "cre", "crer", "rcre"):
                effect = _single_row(table, arm, family, quantity)
                cells += [f"{effect['plain']:.2f}", f"{effect['value']:.2f}"]
                if quantity != "crer":
                    cells.append(_difference(effect))
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _clean(table: pl.DataFrame) -> str:
    arms = table["arm"].unique(maintain_order=True)
    effects = {arm: _single_row(table, arm, CLEAN, "epe_clean") for arm in arms}
    changes = (f"{arm} {effect['value']:.2f} ({_difference(effect)})" for arm, effect in effects.items())
    return f"Clean EPE, px: plain {next(iter(effects.values()))['plain']:.2f}; {'; '.join(changes)}."


def _difference(effect: dict[str, Any]) -> str:
    if effect["low"] is None:
        return f"{effect['difference']:+.2f}"
    return f"{effect['difference']:+.2f} [{effect['low']:+.2f}, {effect['high']:+.2f}]"


def _single_row(table: pl.DataFrame, arm: str, under: str, quantity: str) -> dict[str, Any]:
    return table.row(
        by_predicate=(pl.col("arm") == arm) & (pl.col("under") == under) & (pl.col("quantity") == quantity), named=True
    )
