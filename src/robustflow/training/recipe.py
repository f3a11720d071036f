"""Recipes: everything that determines how a method is trained in one stage, read from `recipes/METHOD.toml`, with the
objective of a method that learns without labels as a table.

Start times are given as fractions of the training run, so that a shorter run includes all phases.

Each field has the value given in the recipe's source; `unverified` lists values that could not be verified, and
`differs` lists differences between the paper and the original code.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError

from ..core.errors import UsageError, class_and_message, first_misfit, unknown_name
from ..core.files import digest_of_value
from ..core.paths import user_path
from ..core.plugins import accepts
from ..core.types import FrozenFinite
from ..models.catalog import PTLFLOW
from ..models.registered import MODELS

Range = tuple[float, float]


class Appearance(FrozenFinite):
    """Changes to the frames' colours for ARFlow's second pass, applied in this order."""

    brightness: float = Field(default=0.5, ge=0)
    contrast: float = Field(default=0.0, ge=0)
    saturation: float = Field(default=0.0, ge=0)
    blur: float = Field(default=3.0, ge=0)
    gamma: Range | None = None


class Spatial(FrozenFinite):
    """Motion of the frames for ARFlow's second pass. `relative_*` is additional motion of the second frame."""

    translation: float = Field(default=0.04, ge=0)
    zoom: Range = (1.0, 1.4)
    squeeze: Range = (1.0, 1.0)
    rotation: Range = (-0.01, 0.01)
    relative_translation: float = Field(default=0.005, ge=0)
    relative_zoom: Range = (0.99, 1.01)
    relative_squeeze: Range = (1.0, 1.0)
    relative_rotation: Range = (-0.01, 0.01)
    constant_rotation: bool = True
    horizontal: bool = True
    vertical: bool = False
    noise: float = Field(default=0.04, ge=0)


class ArflowObjective(FrozenFinite):
    """ARFlow's objective (Liu et al., CVPR 2020)."""

    kind: Literal["arflow"]
    census_from: float = Field(0.05, ge=0, le=1)
    smooth: float = Field(75.0, ge=0)
    second_order: bool = True
    self_supervision: float = Field(0.0, ge=0)
    appearance: Appearance = Appearance()
    spatial: Spatial = Spatial()


class UpflowObjective(FrozenFinite):
    """UPFlow's objective (Luo et al., CVPR 2021)."""

    kind: Literal["upflow"]
    photometric: float = Field(1.0, ge=0)
    census: float = Field(1.0, ge=0)
    smooth: float = Field(1.0, ge=0)
    distillation: float = Field(1.0, ge=0)
    exponent: float = Field(0.4, gt=0)
    radius: int = Field(3, ge=1)


class BrightflowObjective(FrozenFinite):
    """BrightFlow's objective (Marsal et al., WACV 2023)."""

    kind: Literal["brightflow"]
    census: float = Field(0.5, ge=0)
    smooth: float = Field(2.0, ge=0)
    second_order: bool = True
    occlusion: Literal["brox", "wang"] = "brox"
    self_supervision: float = Field(0.3, ge=0)
    self_supervision_from: float = Field(0.4, ge=0, le=1)
    self_supervision_to: float = Field(0.5, ge=0, le=1)
    border: int = Field(64, ge=0)
    corrector: float = Field(0.1, ge=0)
    corrector_from: float = Field(20 / 75, ge=0, le=1)
    corrected_from: float = Field(25 / 75, ge=0, le=1)


Objective = Annotated[ArflowObjective | UpflowObjective | BrightflowObjective, Field(discriminator="kind")]


FOLDER = "recipes"
MIXES = "mixes"
"""Name of the file with the mixes of data; each of the other files describes a method."""


_NONE = BeforeValidator(lambda value: None if value == "none" else value)
"""TOML has no null value, so None is written as "none"."""


_Log2 = Annotated[float, Field(ge=-3, le=3)]
"""A power of two by which frames are scaled; the recipes use -0.5 to 1."""


def _ascending(limits: Range) -> Range:
    if limits[0] > limits[1]:
        raise ValueError("the first limit is larger than the second")
    return limits


class Optimizer(FrozenFinite):
    """The optimiser's settings, except the learning rate."""

    name: Literal["adamw", "adam"] = "adamw"
    weight_decay: float = Field(ge=0)
    decay_biases: bool = True
    eps: float = Field(1e-8, gt=0)
    betas: tuple[float, float] = (0.9, 0.999)
    amsgrad: bool = False
    clip: Annotated[float | None, _NONE] = Field(1.0, gt=0)
    """Maximum total norm of all gradients; None ("none" in a file) for no clipping."""


class Part(FrozenFinite):
    """A dataset's part in a mix."""

    data: str
    options: dict[str, str | int] = Field(default_factory=dict)
    keys: Literal["all", "training"] = "all"
    times: int = Field(1, ge=1, le=1000)
    augmentation: Literal["dense", "sparse", "stretched", "cropped"]
    log2_scale: Annotated[tuple[_Log2, _Log2], AfterValidator(_ascending)] = (0.0, 0.0)
    flip: bool
    eraser: bool = True
    margin: int = Field(0, ge=0, le=1000)


class Mix(FrozenFinite):
    """A mix of data, as in `recipes/mixes.toml` or a user's file."""

    parts: tuple[Part, ...] = Field(min_length=1)


class Recipe(FrozenFinite):
    """One stage of one method."""

    method: str
    stage: str
    start: str
    mix: str
    steps: int = Field(ge=1)
    extra_update: bool = False
    batch: int = Field(ge=1)
    accumulate: int = Field(1, ge=1)
    devices: int = Field(1, ge=1)
    crop: tuple[int, int]
    learning_rate: float = Field(gt=0)
    schedule: Literal["one_cycle", "constant", "constant_then_decay"] = "one_cycle"
    schedule_ahead: int = Field(0, ge=0)
    optimizer: Optimizer
    iterations: Annotated[int | None, _NONE] = Field(12, ge=1)
    loss: Literal["sequence", "sequence+matching", "denoising"] = "sequence"
    gamma: float = Field(0.8, gt=0, le=1)
    objective: Objective | None = None
    noise: float = Field(0.0, ge=0)
    frozen_norms: Literal["none", "batchnorm", "all"] = "none"
    frozen: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    precision: Literal["fp32", "fp16", "bf16"] = "fp32"
    source: str
    unverified: tuple[str, ...] = ()
    differs: tuple[str, ...] = ()

    @property
    def updates(self) -> int:
        """Return the number of updates of the weights."""
        return self.steps // self.accumulate + self.extra_update

    @property
    def pairs(self) -> int:
        """Return the number of pairs used for one update."""
        return self.batch * self.accumulate

    def digest(self) -> str:
        """Return a hash of everything that determines the weights, as 32 hexadecimal digits."""
        words = {"source", "unverified", "differs", "unused"}
        return digest_of_value(self.model_dump(mode="json", exclude=words), size=16)

    def changed(self, **changes: Any) -> Recipe:
        """Replace values of this recipe and check it again; values of None are ignored."""
        set_values = {key: value for key, value in changes.items() if value is not None}
        if "steps" in set_values:
            set_values.setdefault("extra_update", False)
        recipe = _validated({**self.model_dump(), **set_values})
        if not recipe.updates:
            raise UsageError("--steps", f"{recipe.steps} of the {recipe.accumulate} steps of one update; give more")
        return recipe


def load_recipe(method: str, stage: str) -> Recipe:
    """Return the recipe of a method's stage."""
    stages = recipes_of(method)
    if stage not in stages:
        raise unknown_name(f"recipe of {method}", stage, list(stages))
    return stages[stage]


@cache
def recipes_of(method: str) -> dict[str, Recipe]:
    """Return every stage of a method, in file order. The file may name the model (`method`), or a different
    method with the same stages (`same_as`).
    """
    if method not in trained_methods():
        raise unknown_name("trainable method", method, trained_methods())
    document = dict(_read(method))
    if "same_as" in document:
        return {stage: recipe.changed(method=method) for stage, recipe in recipes_of(document["same_as"]).items()}
    common = document.pop("all", {})
    return {
        stage: _validated(_merged({"method": method, **common}, {**entry, "stage": stage}))
        for stage, entry in document.items()
    }


@cache
def trained_methods() -> list[str]:
    """Return the methods that have recipes."""
    names = (entry.name for entry in files(__package__).joinpath(FOLDER).iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml") and name != f"{MIXES}.toml")


def is_own(method: str) -> bool:
    """Return whether a method is a user's network, "module:attribute"."""
    return ":" in method and not method.startswith(PTLFLOW)


def takes_iterations(method: str) -> bool:
    """Return whether the number of iterations is an option of a method.

    >>> takes_iterations("raft"), takes_iterations("tiny"), takes_iterations("my.nets:Net")
    (True, False, False)
    """
    return not is_own(method) and (method not in MODELS or accepts(MODELS.get(method), "iterations"))


def mix_parts(name: str) -> tuple[Part, ...]:
    """Return the parts of a mix given by name or as a user's TOML file with `parts` in the format of
    `recipes/mixes.toml`.
    """
    if name.endswith(".toml"):
        return _parts_of_mix_file(user_path(name))
    mixes = _read(MIXES)
    if name not in mixes:
        raise unknown_name("mix of data", name, list(mixes))
    return Mix.model_validate(mixes[name]).parts


def _parts_of_mix_file(path: Path) -> tuple[Part, ...]:
    try:
        return Mix.model_validate(tomllib.loads(path.read_text(encoding="utf-8"))).parts
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError, ValidationError) as error:
        reason = first_misfit(error) if isinstance(error, ValidationError) else class_and_message(error)[:200]
        raise UsageError(
            path,
            f"not a valid mix of data ({reason}); expected "
            'parts = [{data = "sintel", augmentation = "dense", log2_scale = [-0.2, 0.6], flip = true}, ...]',
        ) from error


@cache
def _read(name: str) -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath(FOLDER, f"{name}.toml").read_text(encoding="utf-8"))


def _merged(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Merge `own` into `common`, including nested tables; `own` takes precedence, and the remarks of both are kept."""
    tables = {key: {**common[key], **own[key]} for key in common if isinstance(common[key], dict) and key in own}
    remarks = {key: _remarks(common.get(key, ())) + _remarks(own.get(key, ())) for key in ("unverified", "differs")}
    return {**common, **own, **tables, **remarks}


def _remarks(given: str | Sequence[str]) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else tuple(given)


def _validated(values: dict[str, Any]) -> Recipe:
    try:
        return Recipe.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise UsageError(
            where,
            f"recipe {values.get('method')} {values.get('stage')}: not {first.get('input')!r} ({first['msg']})",
        ) from error
