"""What is to be computed: a `Plan` of samples, conditions and a model, its units, the identity of their rows, and the
`Job` that worker processes receive."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..attacks.registry import ATTACK_VERSION
from ..core.errors import UsageError
from ..core.types import Flow, Frame
from ..corruptions.api import STREAM_VERSION, load_corruption, user_sources
from ..corruptions.corruption import BGR, VARIANTS, Corruption
from ..corruptions.registry import ON_DISK
from ..data.benchmarks.benchmark import Benchmark
from ..data.datasets.clips import window_on
from ..data.datasets.dataset import Dataset, Depths
from ..metrics.rows import CLEAN, ROW_SCHEMA_VERSION
from ..models import ModelRef
from ..models.objects import as_model
from ..models.protocols import AnyModel, FlowLookup, Window, given_name, model_identity
from ..models.provenance import DECLARED, UNDECLARED, Training, training_of
from .config import DEFAULTS, FrameOptions, MeasuringOptions, RunConfig
from .identity import IDENTITY_VERSION, FrameIdentity, Identity, Measuring, ModelIdentity, recorded_scale
from .manifest import Cell, Cells

if TYPE_CHECKING:
    from ..attacks import Attack


@dataclass(frozen=True)
class NamedModel:
    """A model that every process of a run can load: by its reference if it has one, otherwise as a pickled object."""

    ref: ModelRef | None
    model: AnyModel
    identity: dict[str, Any]
    training: Training = UNDECLARED
    name: str | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | ({} if self.ref is None else {"model": None})

    @property
    def label(self) -> str:
        """The model's name in error messages."""
        object_name = self.identity.get("name") or self.identity.get("object") or "model"
        return self.name or (str(object_name) if self.ref is None else self.ref.name)

    def load(self) -> AnyModel:
        """Return the model; a copy in another process loads it by its reference."""
        return self.ref.load() if self.ref is not None and self.model is None else self.model

    def on(self, device: str) -> NamedModel:
        """Return the model on one device, if it is loaded by a reference."""
        return self if self.ref is None else replace(self, ref=self.ref.on(device))


def name_model(model: str | Path | ModelRef | AnyModel | Callable[..., Any]) -> NamedModel:
    """Load a model by name, path or reference, or wrap a model object; raise a UsageError if it declares an unknown
    training set."""
    parsed = ModelRef.parse(model) if isinstance(model, str | Path) else model
    ref = parsed if isinstance(parsed, ModelRef) else None
    loaded = as_model(model, f"the model {model!r}") if ref is None else ref.load()
    identity = model_identity(loaded) if ref is None else ref.identity(loaded)
    declared = dict(ref.options if ref else ()).get(DECLARED, getattr(loaded, DECLARED, None))
    own_name = given_name(loaded) if ref is None or ref.is_own else None
    return NamedModel(ref, loaded, identity, training_of(identity, declared), own_name)


def load_predictor(model: str | Path | ModelRef | AnyModel) -> NamedModel:
    """Load a model as `name_model` does, and check that it can predict the flow of new frames."""
    named = name_model(model)
    if isinstance(named.model, FlowLookup):
        raise UsageError("--model", "flow files cannot be used to predict new frames")
    return named


class NoMotion:
    """A placeholder for a model whose prediction is not needed: the flow is zero everywhere."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Return zero flow, float32 (H, W, 2)."""
        return np.zeros((*frame1.shape[:2], 2), np.float32)


NO_MODEL = NamedModel(None, NoMotion(), {})


@dataclass(frozen=True)
class Unit:
    """One corruption of one sample, at all missing severities: what is computed and written as a whole."""

    key: str
    corruption: str
    severities: tuple[int, ...]

    @property
    def cells(self) -> list[Cell]:
        return [(self.key, self.corruption, severity) for severity in self.severities]


@dataclass(frozen=True)
class Job:
    """Everything that a worker needs to compute units; picklable if the dataset and the model are."""

    dataset: Dataset
    model: NamedModel = NO_MODEL
    frames: FrameOptions = DEFAULTS.frames
    measuring: MeasuringOptions = DEFAULTS.measuring
    window: Window | None = None
    """The frames around each pair that a multi-frame model receives; None for a two-frame model."""
    corruptions: Mapping[str, Corruption] = field(default_factory=dict)
    """The corruptions by name, without those that exist only as files."""
    depth: Depths | None = None
    """The source of depth for corruptions that need it; None if there is no depth."""
    attacks: Mapping[str, Attack] = field(default_factory=dict)
    """The attacks on the model by name, with the perturbations that they were trained to make."""
    batch_size: int = 1
    folder: Path | None = None
    """The run's folder, in which clean flows are stored between units; None to store none."""
    pictures: Path | None = None
    """The folder in which workers store small pictures of corrupted frames; None to store none."""
    kept: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    """Clean rows that the run already has, by sample; when a sample is resumed, measuring it again must yield the same
    row."""
    first: str | None = None
    """The sample whose clean flow is tested for a wrong format."""
    asked_twice: bool = False
    """Whether the clean flow of the first sample is predicted twice, to see whether the model is deterministic."""


def load_corruptions(benchmark: Benchmark, frames: FrameOptions) -> dict[str, Corruption]:
    """Load a benchmark's corruptions by name, without those that exist only as files."""
    return {
        name: load_corruption(name, frames.variant, frames.severity_scale, benchmark.classes)
        for name in benchmark.corruptions
        if not (benchmark.closed and name in ON_DISK)
    }


@dataclass(frozen=True)
class Plan:
    """A benchmark, a model and the options of a run."""

    benchmark: Benchmark
    model: NamedModel = NO_MODEL
    config: RunConfig = DEFAULTS
    corruptions: Mapping[str, Corruption] = field(default_factory=dict)
    """See `load_corruptions`."""
    attacks: Mapping[str, Attack] = field(default_factory=dict)
    """The attacks by name."""
    attack_sources: Mapping[str, str] = field(default_factory=dict)
    """Digests, by attack, of everything except its name that affects it."""
    name: str | None = None
    """The model's name in tables and figures; it does not affect results."""
    pictures: Path | None = None
    """The folder in which workers store small pictures of corrupted frames; it does not affect results."""

    @property
    def window(self) -> Window | None:
        """The frames around each pair that a multi-frame model receives; None for a two-frame model."""
        return window_on(self.model.model, self.benchmark.dataset)

    def of_corruptions(self, names: Iterable[str]) -> Plan:
        """Return the plan with other corruptions."""
        benchmark = replace(self.benchmark, corruptions=tuple(names))
        return replace(self, benchmark=benchmark, corruptions=load_corruptions(benchmark, self.config.frames))

    def job(self, **of_run: Any) -> Job:
        """Return what a worker needs, with the given fields of `Job`, which depend on the run's folder."""
        return Job(
            dataset=self.benchmark.dataset,
            model=self.model,
            frames=self.config.frames,
            measuring=self.config.measuring,
            window=self.window,
            corruptions=self.corruptions,
            depth=self.benchmark.depths,
            attacks=self.attacks,
            batch_size=self.config.compute.batch_size,
            pictures=self.pictures,
            **of_run,
        )

    def units(self) -> list[Unit]:
        """Return all units of a complete run, with each sample's clean unit first."""
        return self.missing(set())

    def count(self) -> int:
        """Return the number of units in a complete run."""
        cells = self.cells()
        return len(cells.samples) * (1 + len(cells.corruptions) + len(cells.attacks))

    def cells(self) -> Cells:
        """Return the cells of a complete run."""
        chosen, scale = self.benchmark, self.config.frames.severity_scale
        levels = {one.name: one.levels(chosen.severities, scale) for one in chosen.conditions}
        return Cells(
            samples=tuple(chosen.keys),
            corruptions={name: of_name for name, of_name in levels.items() if of_name},
            attacks=dict.fromkeys(chosen.attacks, chosen.severities),
        )

    def left_out(self) -> dict[str, tuple[int, ...]]:
        """Return the requested severities that do not exist on the severity scale, by corruption."""
        chosen, planned = self.benchmark, self.cells().corruptions
        asked = {one.name: one.levels(chosen.severities) for one in chosen.conditions}
        left = {name: tuple(at for at in levels if at not in planned.get(name, ())) for name, levels in asked.items()}
        return {name: levels for name, levels in left.items() if levels}

    def missing(self, existing: AbstractSet[Cell]) -> list[Unit]:
        """Return the planned units that are not done yet."""
        cells = self.cells()
        conditions = {CLEAN: (0,), **cells.corruptions, **cells.attacks}
        left = (
            Unit(key, name, tuple(level for level in levels if (key, name, level) not in existing))
            for key in cells.samples
            for name, levels in conditions.items()
        )
        return [unit for unit in left if unit.severities]

    @cached_property
    def identity(self) -> Identity:
        """The identity of the run's rows."""
        frames, chosen = self.config.frames, self.benchmark
        # a run of attacks alone may have a variant that corruptions lack
        variant = frames.variant if frames.variant in (*VARIANTS, BGR) else "default"
        return Identity(
            frames=FrameIdentity(
                benchmark=chosen.name,
                dataset=chosen.dataset.name,
                protocol=_json_types(chosen.protocol),
                **dict(frames) | {"severity_scale": recorded_scale(frames.severity_scale)},
                streams=STREAM_VERSION,
                attacks=ATTACK_VERSION,
                depth=chosen.own_depth.digest if chosen.own_depth is not None else None,
                attack_sources=dict(self.attack_sources),
                **user_sources(self.corruptions.values(), variant),
            ),
            model=ModelIdentity(
                settings=_json_types(self.model.identity),
                window=self.window.record() if self.window else None,
            ),
            measuring=Measuring(version=IDENTITY_VERSION, rows=ROW_SCHEMA_VERSION, **dict(self.config.measuring)),
        )


def _json_types(value: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values to the form in which they are read from a manifest: lists for tuples, strings for types that JSON
    lacks."""
    out: dict[str, Any] = json.loads(json.dumps(dict(value), default=str))
    return out
