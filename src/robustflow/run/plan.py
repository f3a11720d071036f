"""Define what has to run: samples, corruptions and severities, and the identity of the results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from ..attacks.registry import ATTACK_VERSION
from ..corruptions.api import STREAM_VERSION
from ..corruptions.base import Corruption
from ..corruptions.stack import levels_of
from ..data.benchmarks.base import Benchmark
from ..data.datasets.base import Depths
from ..metrics.rows import CLEAN, ROW_SCHEMA_VERSION
from ..models.base import Window
from ..models.provenance import UNDECLARED, Training
from .cells import Cell, Cells
from .config import FrameOptions, MeasuringOptions
from .identity import (
    IDENTITY_VERSION,
    FrameIdentity,
    Identity,
    Measuring,
    ModelIdentity,
    recorded_scale,
)
from .manifest import Manifest


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
class RunOptions:
    """Options that change the results, apart from the benchmark and the model."""

    frames: FrameOptions = field(default_factory=FrameOptions)
    measuring: MeasuringOptions = field(default_factory=MeasuringOptions)
    sources: Mapping[str, Any] = field(default_factory=dict)
    """Keys of the user's files that affect corrupted frames (see `corruptions.sources`)."""
    window: Window | None = None
    """The frames around each pair that a multi-frame model receives; None for a two-frame model."""
    own: tuple[Any, ...] = ()
    """The user's corruptions, classes or objects, to register in worker processes (see `corruptions.own`)."""
    classes: Mapping[str, type[Corruption]] = field(default_factory=dict)
    """Corruption classes by name, see `Benchmark.classes`."""
    attacks: tuple[str, ...] = ()
    """The conditions that are attacks on the model; the others are corruptions."""
    own_attacks: tuple[Any, ...] = ()
    """The user's attacks, like `own` (see `attacks.own`)."""
    learned: Mapping[str, Mapping[int, Any]] = field(default_factory=dict)
    """Trained perturbations by attack and severity."""
    attack_sources: Mapping[str, str] = field(default_factory=dict)
    """Digests, by attack, of everything except its name that affects it."""
    depth: Depths | None = None
    """The source of depth for corruptions that need it; None if there is no depth."""
    run: str = ""
    """Digest of the run's identity, by which clean flows of a different run in the same folder are recognized."""
    pictures: Path | None = None
    """The folder in which workers store small pictures of corrupted frames; None to store none. It does not affect
    results."""


@dataclass(frozen=True)
class Plan:
    """A benchmark, the options of the run, and the identity of the model."""

    benchmark: Benchmark
    options: RunOptions
    model_identity: dict[str, Any]
    training: Training = UNDECLARED
    name: str | None = None
    """The model's name in tables and figures; it does not affect results."""

    def units(self) -> list[Unit]:
        """Return all units of a complete run, with each sample's clean unit first."""
        return self.missing(set())

    def count(self) -> int:
        """Return the number of units in a complete run."""
        cells = self.cells()
        return len(cells.samples) * (1 + len(cells.corruptions) + len(cells.attacks))

    def cells(self) -> Cells:
        """Return the cells of a complete run."""
        chosen, scale = self.benchmark, self.options.frames.severity_scale
        levels = {name: levels_of(name, chosen.severities, scale) for name in chosen.corruptions}
        return Cells(
            samples=tuple(chosen.keys),
            corruptions={name: of_name for name, of_name in levels.items() if of_name},
            attacks=dict.fromkeys(chosen.attacks, chosen.severities),
        )

    def left_out(self) -> dict[str, tuple[int, ...]]:
        """Return the requested severities that do not exist on the severity scale, by corruption."""
        asked, scale = self.benchmark.severities, self.options.frames.severity_scale
        lacking = {name: lacking_levels(name, levels_of(name, asked), scale) for name in self.benchmark.corruptions}
        return {name: levels for name, levels in lacking.items() if levels}

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

    def identity(self) -> Identity:
        """Return the identity of the run's rows."""
        options = self.options
        return Identity(
            frames=FrameIdentity(
                benchmark=self.benchmark.name,
                dataset=self.benchmark.dataset.name,
                protocol=_json_types(self.benchmark.protocol),
                **dict(options.frames) | {"severity_scale": recorded_scale(options.frames.severity_scale)},
                streams=STREAM_VERSION,
                attacks=ATTACK_VERSION,
                depth=self.benchmark.own_depth.digest if self.benchmark.own_depth is not None else None,
                attack_sources=dict(options.attack_sources),
                **options.sources,
            ),
            model=ModelIdentity(
                settings=_json_types(self.model_identity),
                window=options.window.record() if options.window else None,
            ),
            measuring=Measuring(version=IDENTITY_VERSION, rows=ROW_SCHEMA_VERSION, **dict(options.measuring)),
        )

    def digest(self) -> str:
        """Return the digest of the identity, 16 hexadecimal digits."""
        return self.identity().digest()


def unfinished_samples(manifest: Manifest, cells: set[Cell]) -> set[str]:
    """Return the samples for which a run lacks a row, including rows of attacks."""
    parts = manifest.planned
    return {cell[0] for part in parts for cell in chain(part.corrupted(), part.attacked()) if cell not in cells}


def lacking_levels(name: str, severities: Sequence[int], scale: str) -> tuple[int, ...]:
    """Return those of a corruption's severities that do not exist on a severity scale.

    >>> lacking_levels("saturate", (1, 5), "calibrated"), lacking_levels("saturate", (1, 5), "paper")
    ((5,), ())
    """
    exist = levels_of(name, tuple(severities), scale)
    return tuple(level for level in severities if level not in exist)


def left_out_sentence(left_out: Mapping[str, Sequence[int]]) -> str:
    """Describe which severities a run omits.

    >>> left_out_sentence({"saturate": [5], "h264_crf": [1, 2]})
    'the calibrated scale has no saturate at severity 5, h264_crf at severity 1, 2'
    """
    each = ", ".join(f"{name} at severity {', '.join(map(str, levels))}" for name, levels in left_out.items())
    return f"the calibrated scale has no {each}"


def _json_types(value: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values to the form in which they are read from a manifest: lists for tuples, strings for types that JSON
    lacks."""
    out: dict[str, Any] = json.loads(json.dumps(dict(value), default=str))
    return out
