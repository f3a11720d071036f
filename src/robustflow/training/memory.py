"""Estimate the memory use of a training run from the number of values that autograd keeps
(`bench/training_memory.py`)."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

from .recipe import Recipe

TABLE = "memory.csv"
_COPIES = 4
"""Number of values per trained weight: the weight, its gradient and AdamW's two moments."""
_BYTES = 4


def expected_memory(recipe: Recipe) -> float | None:
    """Return the memory, in GiB, for weights, gradients, moments and the values kept for the backward pass, with the
    entire batch on one device in single precision; None for a network that was not measured.
    """
    row = _table().get(recipe.method)
    if row is None:
        return None
    pixels, rounds = recipe.crop[0] * recipe.crop[1], recipe.iterations or 1
    per_pair = (row["pixel"] + rounds * row["iteration_pixel"]) * pixels
    per_pair += (row["pixel_pair"] + rounds * row["iteration_pixel_pair"]) * pixels**2
    weights = _BYTES * (_COPIES * row["learning"] + row["frozen"])
    return (recipe.batch * per_pair + weights) / 2**30


@cache
def _table() -> dict[str, dict[str, float]]:
    lines = files(__package__).joinpath(TABLE).read_text(encoding="utf-8").splitlines()
    return {row.pop("method"): {key: float(value) for key, value in row.items()} for row in csv.DictReader(lines)}
