"""A recipe: everything that determines how a method is trained in one stage, read from `recipes/METHOD.toml`.

Each field has the value of its source; `unverified` lists what could not be verified, `differs` where the paper and the
original differ.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError

from ..digest import digest_of_value
from ..errors import UsageError, unknown_name
from ..validated import Frozen
from .objectives import Objective

FOLDER = "recipes"
MIXES = "mixes"
"""Name of the file that holds the mixes of data; the others are methods."""


_NONE = BeforeValidator(lambda value: None if value == "none" else value)
"""A TOML file has no None and says "none"."""


class Optimizer(Frozen):
    """The optimiser's settings, besides the learning rate."""

    name: Literal["adamw", "adam"] = "adamw"
    weight_decay: float = Field(ge=0)
    decay_biases: bool = True
    eps: float = Field(1e-8, gt=0)
    betas: tuple[float, float] = (0.9, 0.999)
    amsgrad: bool = False
    clip: Annotated[float | None, _NONE] = Field(1.0, gt=0)
    """Largest norm of all gradients together; None, in a file "none", for no clipping."""


class Part(Frozen):
    """A data set's part in a mix.

    Attributes:
        data: the data set, by its registered name.
        options: of the data set.
        keys: "all", or "training" for those that the project's split leaves for training.
        times: how often each pair occurs in an epoch.
        augmentation: "dense" or "sparse" (see `augmentation/`); for training without labels also "stretched" to the
            crop's size, or "cropped", in both with half of the pairs exchanged.
        log2_scale: range of the power of two by which frames are scaled; not for the last two.
        flip: whether frames are flipped.
        eraser: whether rectangles of the second frame are erased; for "dense" and "sparse".
        margin: pixels of a "cropped" frame's border that no crop reaches.
    """

    data: str
    options: dict[str, str | int] = Field(default_factory=dict)
    keys: Literal["all", "training"] = "all"
    times: int = Field(1, ge=1)
    augmentation: Literal["dense", "sparse", "stretched", "cropped"]
    log2_scale: tuple[float, float] = (0.0, 0.0)
    flip: bool
    eraser: bool = True
    margin: int = Field(0, ge=0)


class Recipe(Frozen):
    """One stage of one method.

    Attributes:
        method: the model's registered name.
        stage: "chairs", "things", "sintel", "kitti" of the originals, "ood" or "id" of the paper; "unsupervised" and
            others of methods that learn without labels.
        start: which weights it starts from: "random", or a stage.
        mix: of `recipes/mixes.toml`, or a file like it.
        steps: number of batches, as counted by the source.
        extra_update: whether the original makes one more update than `steps`.
        batch: pairs per step, over all devices.
        accumulate: steps for one update of the weights.
        devices: over how many the original's batch was spread, which determines the share that a BatchNorm normalises
            over.
        schedule_ahead: updates by which the schedule is ahead of the training: 1 where the first update has the rate of
            the schedule's second.
        crop: (H, W), pixels.
        iterations: of a recurrent network; None, in a file "none", for one without.
        loss: "sequence"; "sequence+matching", with GMFlowNet's loss of its matching; or "denoising", the sequence loss
            of flows that are denoised from the truth (FlowDiffuser).
        gamma: of the sequence loss.
        objective: what is minimised by a method that learns without labels, instead of the sequence loss.
        noise: the largest standard deviation, in grey levels, of the noise added to both frames; 0 for none.
        frozen_norms: "none", "batchnorm" (running statistics stay) or "all".
        frozen: parts of the network, by the beginning of their parameters' names, that do not learn.
        unused: parts, likewise, that the network has but never computes with, also in the original: they get no
            gradient.
        precision: "fp32", "fp16" (mixed, with loss scaling) or "bf16" (mixed).
        source: where this comes from.
        unverified: what could not be checked.
        differs: where the paper, the original and this recipe differ, and which is followed.
    """

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
        """The number of updates of the weights."""
        return self.steps // self.accumulate + self.extra_update

    @property
    def pairs(self) -> int:
        """The number of pairs that one update is computed from."""
        return self.batch * self.accumulate

    def digest(self) -> str:
        """A hash, 32 hexadecimal digits, of everything that determines the weights."""
        words = {"source", "unverified", "differs", "unused"}
        return digest_of_value(self.model_dump(mode="json", exclude=words), size=16)

    def changed(self, **changes: Any) -> Recipe:
        """Replace values of this recipe and check it again; those that are None stay.

        Different `steps` drop the original's extra update.

        Raises:
            UsageError: an invalid value.
        """
        given = {key: value for key, value in changes.items() if value is not None}
        if "steps" in given:
            given.setdefault("extra_update", False)
        return _validated({**self.model_dump(), **given})


def load_recipe(method: str, stage: str) -> Recipe:
    """The recipe of a method's stage.

    Raises:
        UsageError: no recipe for the method, or no such stage.

    >>> recipe = load_recipe("raft", "ood")
    >>> recipe.steps, recipe.batch, recipe.crop, recipe.updates
    (100000, 6, (368, 768), 100001)
    """
    stages = recipes_of(method)
    if stage not in stages:
        raise unknown_name(f"recipe of {method}", stage, list(stages))
    return stages[stage]


@cache
def recipes_of(method: str) -> dict[str, Recipe]:
    """Every stage of a method, in the order of its file. The file may name the model (`method`), or another method that
    has the same stages (`same_as`).

    Raises:
        UsageError: no recipe for the method.
    """
    if method not in trained_methods():
        raise unknown_name("method with a recipe", method, trained_methods())
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
    """The methods that have recipes."""
    names = (entry.name for entry in files(__package__).joinpath(FOLDER).iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml") and name != f"{MIXES}.toml")


def mix_parts(name: str) -> tuple[Part, ...]:
    """The parts of a mix: by its name, or from a user's TOML file that holds `parts` as `recipes/mixes.toml` does.

    Raises:
        UsageError: no such mix, or a file that cannot be read as one.

    >>> [(part.data, part.times) for part in mix_parts("ood")]
    [('sintel', 100), ('sintel', 100), ('hd1k', 5), ('flyingthings3d', 1), ('flyingthings3d', 1)]
    """
    if name.endswith(".toml"):
        return _own_parts(Path(name).expanduser())
    mixes = _read(MIXES)
    if name not in mixes:
        raise unknown_name("mix of data", name, list(mixes))
    return tuple(Part.model_validate(part) for part in mixes[name]["parts"])


def _own_parts(path: Path) -> tuple[Part, ...]:
    try:
        parts = tuple(Part.model_validate(part) for part in tomllib.loads(path.read_text(encoding="utf-8"))["parts"])
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError, TypeError, ValidationError) as error:
        reason = " ".join(str(error).split())
        raise UsageError(
            f"{path}: no mix of data can be read from it ({type(error).__name__}: {reason[:200]}); it holds "
            'parts = [{data = "sintel", augmentation = "dense", log2_scale = [-0.2, 0.6], flip = true}, ...]'
        ) from error
    if not parts:
        raise UsageError(f"{path}: a mix of data without parts; name at least one data set")
    return parts


@cache
def _read(name: str) -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath(FOLDER, f"{name}.toml").read_text(encoding="utf-8"))


def _merged(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Merge `own` over `common`, tables within them too, and keep all remarks of both."""
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
            f"recipe {values.get('method')} {values.get('stage')}: {where} cannot be {first.get('input')!r} "
            f"({first['msg']}); correct it"
        ) from error
