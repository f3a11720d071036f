"""Describe a training run before it starts, with its memory, estimated from the number of values that autograd keeps
(`bench/training_memory.py`).
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

from ..core.errors import RobustFlowError, UsageError
from ..core.text import counted
from ..data.datasets import dataset_facts
from .data.find import OpenPart, Order, open_part
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
    """Describe the recipe, the available and missing data and their proportions, the length of the run, and deviations
    from the original recipe.
    """
    lines = [
        f"{recipe.method}, recipe '{recipe.stage}' ({recipe.source})",
        *_changes(recipe, original or recipe),
        *_corrupted(data),
        *_settings(recipe),
        _memory(recipe),
        "data:",
    ]
    available: list[OpenPart] = []
    missing: list[tuple[Part, str]] = []
    for part in mix_parts(recipe.mix):
        try:
            available.append(open_part(part, data.sources, recipe.objective is None))
        except RobustFlowError as error:
            missing.append((part, str(error)))
    places = sum(map(len, available))
    for one in available:
        share = f", {100 * len(one) / places:.1f} % of an epoch" if not missing else ""
        pairs = f"{counted(len(one.keys), 'pair')} x {one.part.times}"
        lines.append(f"  found    {_title(one.part)}: {pairs}{share}; {_augmented(one.part, recipe)}")
    for part, why in missing:
        lines.append(f"  missing  {_title(part)}: {why}")
    obstacle = "training cannot start until the missing data are available" if missing else ""
    if not missing:
        try:
            epochs = recipe.updates / Order(places, recipe.pairs, seed=0).updates
            lines.append(f"{places} pairs per epoch; {counted(recipe.updates, 'update')} are {epochs:.2f} epochs")
        except UsageError as error:
            obstacle = f"training cannot start: {error}"
    for name, remarks in (("not verified", recipe.unverified), ("paper, original and this recipe", recipe.differs)):
        if remarks:
            lines += [f"{name}:", *(f"  {remark}" for remark in remarks)]
    return "\n".join([*lines, obstacle] if obstacle else lines)


def _changes(recipe: Recipe, original: Recipe) -> list[str]:
    """Return one line for each of the user's changes."""
    pairs = ((name, getattr(original, name), getattr(recipe, name)) for name in Recipe.model_fields)
    return [
        f"changed: {name.replace('_', ' ')} {_value_text(value)} instead of {_value_text(before)}"
        for name, before, value in pairs
        if value != before and name != "extra_update"  # determined by `steps`
    ]


def _corrupted(data: DataPlan) -> list[str]:
    transform = data.corruption(seed=0)
    if transform is None:
        return []
    return [f"changed: {100 * data.probability:g} % of the pairs are corrupted: {', '.join(data.corruptions)}"]


def _value_text(value: object) -> str:
    if value is None:
        return "none"
    return "x".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _settings(recipe: Recipe) -> list[str]:
    optimizer = recipe.optimizer
    clip = f"gradients clipped at {optimizer.clip:g}" if optimizer.clip is not None else "no clipping"
    steps = f" in {recipe.accumulate} steps" if recipe.accumulate > 1 else ""
    iterations = f", {counted(recipe.iterations, 'iteration')}" if recipe.iterations is not None else ""
    norms = {"none": "norms learn", "batchnorm": "BatchNorm frozen", "all": "all norms in evaluation mode"}[
        recipe.frozen_norms
    ]
    ahead = f", {counted(recipe.schedule_ahead, 'update')} ahead" if recipe.schedule_ahead else ""
    noise = f", noise up to {recipe.noise:g} grey levels" if recipe.noise else ""
    return [
        f"begins with: {recipe.start}",
        f"{counted(recipe.updates, 'update')} of {counted(recipe.pairs, 'pair')}{steps}, crop "
        f"{recipe.crop[0]}x{recipe.crop[1]}, {recipe.precision}{iterations}",
        f"{optimizer.name}, rate {recipe.learning_rate:g} ({recipe.schedule}{ahead}), weight decay "
        f"{optimizer.weight_decay:g}, {clip}",
        f"{_loss(recipe)}; {norms}{noise}",
    ]


def _loss(recipe: Recipe) -> str:
    if recipe.objective is None:
        return f"{recipe.loss} loss, gamma {recipe.gamma:g}"
    settings = recipe.objective.model_dump(exclude={"kind", "appearance", "spatial"})
    words = {
        name: f"{value:.4g}" if isinstance(value, float) else str(value).lower() for name, value in settings.items()
    }
    return "no labels: " + ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in words.items())


def _memory(recipe: Recipe) -> str:
    expected = expected_memory(recipe)
    if expected is None:
        return "memory: unknown for this network"
    less = "" if recipe.precision == "fp32" else f", less in {recipe.precision}"
    return (
        f"memory: about {expected:.1f} GiB for the whole batch on one device{less} (estimated from the values "
        "kept for the backward pass of one pair; workspaces not included)"
    )


def _title(part: Part) -> str:
    words = [dataset_facts(part.data).title, *map(str, part.options.values())]
    return " ".join(words) + (" (the pairs not in KITTI-FC)" if part.keys == "training" else "")


def _augmented(part: Part, recipe: Recipe) -> str:
    flips = "flips" if part.flip else "no flips"
    if part.augmentation in ("stretched", "cropped"):
        swapped = "" if recipe.objective is None else ", half of the pairs swapped"
        return f"{part.augmentation} to the crop, {flips}{swapped}"
    scale = f"scale 2^{part.log2_scale[0]:g} to 2^{part.log2_scale[1]:g}"
    return f"{part.augmentation} augmentation, {scale}, {flips}" + ("" if part.eraser else ", no eraser")
