"""The experiment in words and tables, as Markdown; nothing is claimed that its intervals do not carry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import polars as pl

from ..datasets import dataset_facts
from ..metrics.rows import CLEAN
from ..text import counted
from .arms import ALL
from .arms import LEFT_OUT as TESTED
from .effects import GUARD, Runs, effects, unguarded

_COLUMNS = ("epe", "cre", "rcre")


def findings(runs: Runs, seeds: int) -> tuple[str, pl.DataFrame]:
    """The page, and every effect as a table (see `effects`).

    Args:
        runs: by (arm, data set, seed).
        seeds: how many.
    """
    parts, tables = [], []
    for dataset in dict.fromkeys(of for _, of, _ in runs):
        title = dataset_facts(dataset).title
        pairs = len(set(next(run for (_, of, _), run in runs.items() if of == dataset).rows["sample"]))
        head = f"## {title}: {counted(pairs, 'pair')}, {counted(seeds, 'seed')}"
        failing = unguarded(runs, dataset)
        table = effects(runs, dataset, seeds)
        tables.append(table)
        if failing:
            parts.append(
                f"{head}\n\nNothing is compared here: {len(failing)} of the networks miss the guard (clean EPE below "
                f"{GUARD:g} x zero flow's): {'; '.join(failing[:3])}{'; ...' * (len(failing) > 3)}."
            )
            continue
        parts.append(f"{head}\n\n{_families(table)}\n\n{_sentences(table)}")
    return "\n\n".join(parts) + "\n", pl.concat(tables)


def _families(table: pl.DataFrame) -> str:
    names = [*("EPE plain", "EPE", "difference"), *("CRE plain", "CRE", "difference"), "CREr plain", "CREr"]
    names += ["RCRE plain", "RCRE", "difference"]
    lines = [f"| under | | {' | '.join(names)} |", "|---|---|" + "---:|" * len(names)]
    for family in TESTED:
        for arm, word in ((f"no_{family}", "not trained with it"), (ALL, "trained with all")):
            cells = [family, word]
            for quantity in ("epe", "cre", "crer", "rcre"):
                effect = _one(table, arm, family, quantity)
                cells += [f"{effect['plain']:.2f}", f"{effect['value']:.2f}"]
                if quantity != "crer":
                    cells.append(_difference(effect))
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _sentences(table: pl.DataFrame) -> str:
    arms = table["arm"].unique(maintain_order=True)
    clean = [_one(table, arm, CLEAN, "epe_clean") for arm in arms]
    changes = [100 * (effect["value"] / effect["plain"] - 1) for effect in clean]
    texts = [
        f"Clean EPE changes by {min(changes):+.1f} to {max(changes):+.1f} % against training on without corruptions "
        f"({clean[0]['plain']:.2f} px); {_settled(clean)}."
    ]
    for word, chosen in (("left out", False), ("trained with", True)):
        for quantity in _COLUMNS:
            effects = [_one(table, f"no_{family}" if not chosen else ALL, family, quantity) for family in TESTED]
            lower = sum(effect["difference"] < 0 for effect in effects)
            before, after = (sum(effect[which] for effect in effects) / len(effects) for which in ("plain", "value"))
            texts.append(
                f"Under families {word}, {quantity.upper()} is lower in {lower} of {len(effects)} (mean {before:.2f} "
                f"to {after:.2f} px, {100 * (after / before - 1):+.0f} %); {_settled(effects)}."
            )
    return "\n".join(f"- {text}" for text in texts)


def _settled(effects: Sequence[dict[str, Any]]) -> str:
    """How many intervals lie on which side of 0."""
    known = [effect for effect in effects if effect["low"] is not None]
    if not known:
        return "too few pairs for intervals, so nothing follows from it for other pairs"
    below, above = (sum(test(effect) for effect in known) for test in (lambda e: e["high"] < 0, lambda e: e["low"] > 0))
    return f"of {len(known)} intervals {below} lie below 0 and {above} above it"


def _difference(effect: dict[str, Any]) -> str:
    if effect["low"] is None:
        return f"{effect['difference']:+.2f}"
    return f"{effect['difference']:+.2f} [{effect['low']:+.2f}, {effect['high']:+.2f}]"


def _one(table: pl.DataFrame, arm: str, under: str, quantity: str) -> dict[str, Any]:
    return table.row(
        by_predicate=(pl.col("arm") == arm) & (pl.col("under") == under) & (pl.col("quantity") == quantity), named=True
    )
