"""Describe a training run before it starts, with its memory, estimated from the number of values that autograd keeps
(`bench/training_memory.py`).
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import Any

from ..core.errors import RobustFlowError, UsageError
from ..data.datasets import dataset_facts
from .data.parts import OpenPart, Order, open_part
from .recipe import Part, Recipe, mix_parts
from .request import DataPlan

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


def plan_text(recipe: Recipe, data: DataPlan, original: Recipe | None = None) -> str:
    """List the values of the recipe and of the original one where they differ, the available and missing data and
    their shares of an epoch, and the length of the run.
    """
    before = dict(_values((original or recipe).model_dump(exclude=_NOT_LISTED)))
    lines = [f"{recipe.method}, recipe '{recipe.stage}' ({recipe.source})", f"updates: {recipe.updates}"]
    for name, value in _values(recipe.model_dump(exclude=_NOT_LISTED)):
        lines.append(f"{name}: {value}" + (f" instead of {before.get(name)}" if value != before.get(name) else ""))
    if data.corruption(seed=0) is not None:
        lines.append(f"corrupted pairs: {100 * data.probability:g} %: {', '.join(data.corruptions)}")
    if (memory := expected_memory(recipe)) is not None:
        lines.append(f"memory: about {memory:.1f} GiB (the whole batch on one device, fp32, without workspaces)")
    available: list[OpenPart] = []
    missing: list[str] = []
    for part in mix_parts(recipe.mix):
        try:
            available.append(open_part(part, data.sources, recipe.objective is None))
        except RobustFlowError as error:
            missing.append(f"  missing  {_title(part)}: {error}")
    places = sum(map(len, available))
    lines.append("data:")
    for opened in available:
        share = f", {100 * len(opened) / places:.1f} % of an epoch" if not missing else ""
        applied = _values(opened.part.model_dump(exclude={"data", "options", "keys", "times"}))
        augmentation = "; ".join(f"{name} {value}" for name, value in applied)
        lines.append(
            f"  found    {_title(opened.part)}: {len(opened.keys)} pairs x {opened.part.times}{share}; {augmentation}"
        )
    lines += missing
    for name, remarks in (("not verified", recipe.unverified), ("paper, original and this recipe", recipe.differs)):
        if remarks:
            lines += [f"{name}:", *(f"  {remark}" for remark in remarks)]
    if missing:
        return "\n".join([*lines, "training cannot start until the missing data are available"])
    try:
        epochs = recipe.updates / Order(places, recipe.pairs, seed=0).updates
        return "\n".join([*lines, f"{places} pairs per epoch; {recipe.updates} updates are {epochs:.2f} epochs"])
    except UsageError as error:
        return "\n".join([*lines, f"training cannot start: {error}"])


_NOT_LISTED = {"method", "stage", "source", "unverified", "differs", "unused"}
"""Fields of a recipe that are printed elsewhere, or do not affect the training."""


def _values(fields: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the fields that are set, as text; the names of a nested table's fields begin with the table's name."""
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from _values(value, f"{prefix}{name} ")
        elif isinstance(value, tuple):
            yield f"{prefix}{name}", ", ".join(map(str, value)) or "none"
        else:
            yield f"{prefix}{name}", "none" if value is None else str(value)


def _title(part: Part) -> str:
    words = [dataset_facts(part.data).title, *map(str, part.options.values())]
    return " ".join(words) + (" (the pairs not in KITTI-FC)" if part.keys == "training" else "")
