"""What follows from the paired tests of `estimate.contrast`: sentences, ranks with ties, and group letters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, combinations_with_replacement
from string import ascii_letters
from typing import Any

import polars as pl

from ..core.errors import RunError
from ..core.text import counted
from ..metrics.measures import EVERY
from .inference import FEWEST
from .ranking import competition_ranks
from .results import AVERAGE, CLEAN, long_label


def difference_sentence(row: Mapping[str, Any]) -> str:
    """State the difference between two models in one mean, and its uncertainty (a row of `estimate.CONTRASTS`).

    >>> row = {"model": "A", "against": "B", "measure": "cre", "condition": "fog", "value": -0.42, "low": -0.7,
    ...        "high": -0.1, "ratio": None, "p_adjusted": 0.02, "comparisons": 1, "pairs": 80, "clusters": 80,
    ...        "wins": 61, "losses": 19}
    >>> difference_sentence(row)
    'Fog CRE of A minus B: -0.42 px (95 % interval -0.70 to -0.10; p = 0.020; lower on 61 of 80 images): A is lower.'
    """
    measure, p = EVERY[row["measure"]], row["p_adjusted"]
    what = {AVERAGE: "average", CLEAN: "clean"}.get(row["condition"], long_label(row["condition"]))
    observed = counted(row["pairs"], "image")
    if row["clusters"] not in (row["pairs"], None):
        observed += f" in {counted(row['clusters'], 'independent group')}"
    lower, higher = ("lower", "higher") if measure.better <= 0 else ("higher", "lower")
    evidence = []
    if row["low"] is not None:
        evidence.append(f"95 % interval {row['low']:+.2f} to {row['high']:+.2f}")
    if row["ratio"] is not None:
        ends = row.get("ratio_low"), row.get("ratio_high")
        within = "" if None in ends else " ({:.2f} to {:.2f})".format(*ends)
        evidence.append(f"{row['ratio']:.2f} times{within}")
    if p is not None:
        corrected = f", corrected for {row['comparisons']} comparisons" if row["comparisons"] > 1 else ""
        evidence.append(f"p {p_text(p)}{corrected}")
    if row["wins"] is None:
        evidence.append(observed)
    elif row["wins"] >= row["losses"]:
        evidence.append(f"{lower} on {row['wins']} of {observed}")
    else:
        evidence.append(f"{higher} on {row['losses']} of {observed}")
    verdict = "they cannot be told apart"
    if p is None:
        verdict = f"fewer than {FEWEST} independent images are not enough to tell them apart"
    elif is_sure(row):
        verdict = f"{better_of(row)} is {lower}"
    elif row.get("fewer_pixels") == better_of(row):
        verdict = f"{better_of(row)} predicted fewer pixels, so it is not called better"
    difference = f"{row['value']:+.2f} {measure.unit}".rstrip()
    models = f"{row['model']} minus {row['against']}"
    return f"{what} {measure.label} of {models}: {difference} ({'; '.join(evidence)}): {verdict}."


def better_of(row: Mapping[str, Any]) -> str:
    """Return the model with the better value in a contrast."""
    return str(row["model"] if (row["value"] > 0) == (EVERY[row["measure"]].better > 0) else row["against"])


def worse_of(row: Mapping[str, Any]) -> str:
    """Return the other model of a contrast."""
    return str(row["against"] if better_of(row) == row["model"] else row["model"])


def p_text(value: float) -> str:
    """Format a p-value as written after the letter p; values below 0.001 are written as "< 0.001".

    >>> p_text(0.0204), p_text(0.0004)
    ('= 0.020', '< 0.001')
    """
    return "< 0.001" if value < 0.001 else f"= {value:.3f}"


STANDINGS_SCHEMA: dict[str, Any] = {
    "model": pl.String,
    "value": pl.Float64,
    "rank": pl.Int64,
    "best": pl.Int64,
    "worst": pl.Int64,
}
"""`rank` is determined by the values alone; `best` and `worst` are the best and the worst rank that the tests allow."""


def standings(pairs: pl.DataFrame, names: Sequence[str]) -> pl.DataFrame:
    """Rank several models with ties: each model's rank, and the range of ranks that the paired tests allow."""
    if pairs.height != len(names) * (len(names) - 1) // 2:
        raise RunError("not all of these runs measured the same data; a ranking needs runs on the same data")
    values: dict[str, float] = {}
    beaten, beats = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    sign = -1 if pairs.height and EVERY[pairs["measure"][0]].better > 0 else 1
    for row in pairs.iter_rows(named=True):
        values[row["model"]], values[row["against"]] = row["value_model"], row["value_against"]
        if is_sure(row):
            beats[better_of(row)] += 1
            beaten[worse_of(row)] += 1
    ranks = competition_ranks({name: sign * values[name] for name in names})
    records = [(name, values[name], ranks[name], beaten[name] + 1, len(names) - beats[name]) for name in names]
    return pl.DataFrame(records, schema=STANDINGS_SCHEMA, orient="row").sort("rank", "model")


def group_letters(pairs: Iterable[Mapping[str, Any]], names: Sequence[str]) -> dict[str, str]:
    """Return the letters of each model, of which two models share one unless a test tells them apart (the compact
    letter display of Piepho 2004). "a" is the group of the first name.

    >>> rows = [{"model": "A", "against": "C", "p_adjusted": 0.01, "value": -1.0}]
    >>> group_letters(rows, ["A", "B", "C"])
    {'A': 'a', 'B': 'ab', 'C': 'b'}
    """
    groups, alike = [frozenset(names)], set(map(frozenset, combinations_with_replacement(names, 2)))
    for row in filter(is_sure, pairs):
        two = frozenset((row["model"], row["against"]))
        alike.discard(two)
        groups = [part for group in groups for part in ([group - {one} for one in two] if two <= group else [group])]
        groups = [group for group in dict.fromkeys(groups) if not any(group < other for other in groups)]
    lettered = []
    while alike:  # a few of the groups suffice; 20 models can have more than a thousand
        lettered.append(max(groups, key=lambda group: sum(two <= group for two in alike)))
        alike = {two for two in alike if not two <= lettered[-1]}
    lettered.sort(key=lambda group: [name not in group for name in names])
    letters = list(zip(chain(ascii_letters, map(chr, range(0x3B1, 0x400))), lettered, strict=False))
    return {name: "".join(letter for letter, group in letters if name in group) for name in names}


def is_sure(row: Mapping[str, Any]) -> bool:
    """Whether a test tells the models of a contrast apart, by a difference that can be seen and that is not due to
    pixels that only one of them left out."""
    sure = row["p_adjusted"] is not None and row["p_adjusted"] <= 0.05 and f"{abs(row['value']):.2f}" != "0.00"
    return sure and not (row.get("fewer_pixels") and row["fewer_pixels"] == better_of(row))
