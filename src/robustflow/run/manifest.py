"""The manifest of a run, `manifest.json` in its folder and in a record: what was asked for, on which data, and when;
and the cells that it plans: which samples, under which corruptions and attacks, at which severities.

Calls may ask for different conditions on different samples, so a plan is a list of `Cells`: every sample is in exactly
one of them, together with the samples that are measured under the same conditions.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from typing import Annotated, Any, Literal

import polars as pl
from pydantic import AfterValidator, ConfigDict, Field, JsonValue, model_validator

from ..attacks.registry import SHIPPED, attack_spec
from ..core.types import Untrusted
from ..corruptions.condition import condition_of
from ..data.benchmarks.setting import Provenance, provenance_of
from ..metrics.rows import CLEAN, ROW_SCHEMA_VERSION
from ..models.provenance import Training
from .identity import IDENTITY_VERSION, LONGEST_NAME, Environment, Identity, Text
from .trust import document_bytes

LARGEST_MANIFEST = 2**30
"""Maximum size of the file in bytes: of a run with millions of samples."""

_MOST_CELLS = 20_000_000
"""Maximum number of rows of a run: four times those of the largest dataset under every corruption."""

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


_Conditions = tuple[frozenset[tuple[str, tuple[int, ...]]], ...]

Cell = tuple[str, str, int]
"""The sample key, corruption and severity of a row."""

UNEVEN = "not all at the same severities and on the same pairs"
"""Remark about a mean over corruptions, see `Manifest.uneven`."""


def _ascending(levels: tuple[int, ...]) -> tuple[int, ...]:
    if any(one >= other for one, other in pairwise(levels)):
        raise ValueError("severities must be ascending and different")
    return levels


Levels = Annotated[
    tuple[Annotated[int, Field(ge=1, le=5)], ...], Field(min_length=1, max_length=5), AfterValidator(_ascending)
]


class Cells(Untrusted):
    """Some samples, each measured on the clean frames and under the same conditions."""

    samples: tuple[Text, ...]
    corruptions: dict[Text, Levels] = {}
    attacks: dict[Text, Levels] = {}

    def corrupted(self) -> Iterator[Cell]:
        """Yield every cell except those of attacks; clean cells as (sample, "clean", 0)."""
        levels = {CLEAN: (0,), **self.corruptions}
        return ((key, name, level) for key in self.samples for name in levels for level in levels[name])

    def attacked(self) -> Iterator[Cell]:
        """Yield every cell of an attack."""
        levels = self.attacks
        return ((key, name, level) for key in self.samples for name in levels for level in levels[name])

    def every(self) -> Iterator[Cell]:
        """Yield every cell."""
        return chain(self.corrupted(), self.attacked())

    def count(self, attacks: bool = True) -> int:
        """Return the number of cells, with or without those of attacks, without listing them."""
        levels = (*self.corruptions.values(), *(self.attacks.values() if attacks else ()))
        return len(self.samples) * (1 + sum(map(len, levels)))

    def has(self, condition: str, severity: int) -> bool:
        """Return whether a condition is among those of these samples."""
        levels = {CLEAN: (0,), **self.corruptions, **self.attacks}
        return severity in levels.get(condition, ())

    def among(self, keys: Iterable[str]) -> Cells:
        """Return the same conditions of other samples."""
        return self.model_copy(update={"samples": tuple(keys)})

    def contain(self) -> pl.Expr:
        """Return an expression that selects the rows of these cells."""
        of_level: dict[tuple[int, ...], list[str]] = {(0,): [CLEAN]}
        for name, levels in (*self.corruptions.items(), *self.attacks.items()):
            of_level.setdefault(levels, []).append(name)
        conditions = (
            pl.col("corruption").is_in(names) & pl.col("severity").is_in(levels) for levels, names in of_level.items()
        )
        return pl.col("sample").is_in(self.samples) & pl.any_horizontal(*conditions)


def union(every: Iterable[Cells]) -> tuple[Cells, ...]:
    """Return the same cells, with every sample in exactly one of the parts, and no two parts with equal conditions. The
    time is linear in the number of samples and conditions."""
    of_sample: dict[str, Cells] = {}
    parts: dict[_Conditions, Cells] = {}

    def shared(part: Cells) -> Cells:
        """Return the one object with these conditions."""
        return parts.setdefault((frozenset(part.corruptions.items()), frozenset(part.attacks.items())), part.among(()))

    for asked in every:
        alone, together = shared(asked), dict[int, Cells]()
        for key in asked.samples:
            before = of_sample.get(key, alone)
            if id(before) not in together:
                corruptions = merged_levels(before.corruptions, asked.corruptions)
                attacks = merged_levels(before.attacks, asked.attacks)
                together[id(before)] = shared(Cells(samples=(), corruptions=corruptions, attacks=attacks))
            of_sample[key] = together[id(before)]
    samples: dict[int, list[str]] = {}
    for key, part in of_sample.items():
        samples.setdefault(id(part), []).append(key)
    return tuple(part.among(samples[id(part)]) for part in parts.values() if id(part) in samples)


def parts_of(cells: Iterable[Cell], attacks: Collection[str]) -> tuple[Cells, ...]:
    """Return some cells as parts; every sample has its clean cell."""
    of_sample: dict[str, dict[str, list[int]]] = {}
    for key, name, level in cells:
        levels = of_sample.setdefault(key, {})
        if name != CLEAN:
            levels.setdefault(name, []).append(level)
    return union(
        Cells(
            samples=(key,),
            corruptions={name: tuple(sorted(given)) for name, given in levels.items() if name not in attacks},
            attacks={name: tuple(sorted(given)) for name, given in levels.items() if name in attacks},
        )
        for key, levels in sorted(of_sample.items())
    )


def merged_levels(
    one: Mapping[str, tuple[int, ...]], other: Mapping[str, tuple[int, ...]]
) -> dict[str, tuple[int, ...]]:
    """Return the severities that are in either of two mappings, by condition.

    >>> merged_levels({"fog": (3,)}, {"snow": (2,), "fog": (1,)})
    {'fog': (1, 3), 'snow': (2,)}
    """
    return {name: tuple(sorted({*one.get(name, ()), *other.get(name, ())})) for name in {**one, **other}}


def left_out_sentence(left_out: Mapping[str, Sequence[int]]) -> str:
    """Describe which severities a run omits.

    >>> left_out_sentence({"saturate": [5], "h264_crf": [1, 2]})
    'the calibrated scale has no saturate at severity 5, h264_crf at severity 1, 2'
    """
    each = ", ".join(f"{name} at severity {', '.join(map(str, levels))}" for name, levels in left_out.items())
    return f"the calibrated scale has no {each}"


class Clip(Untrusted):
    """The effects of one video corruption on a clip, as recorded by its dataset; `warnings` are shown to the user."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    warnings: tuple[str, ...] = ()


class EarlierEnvironment(Environment):
    """The environment in which a run was computed before it was continued in another one, and the rows that it made."""

    made: Annotated[tuple[Cells, ...], Field(min_length=1)]


class Manifest(Untrusted):
    """The description of a run; `samples` contains the name and the digest of each sample's files, and `environment`
    is that of the rows that none of `earlier` made. `flows_differ_on` is the sample for which the model, when asked
    twice, predicted two different flows; empty if there is none."""

    version: Literal[7]
    identity: Identity
    identity_digest: _Digest
    samples: dict[Text, tuple[tuple[str, _Digest], ...]]
    training: Training
    planned: tuple[Cells, ...]
    left_out: dict[Text, Levels] = {}
    name: Annotated[str, Field(max_length=LONGEST_NAME)] = ""
    started: str
    finished: str | None
    seconds: dict[str, float] = {}
    environment: Environment
    earlier: tuple[EarlierEnvironment, ...] = ()
    places: dict[str, int] = {}
    clips: tuple[Clip, ...] = ()
    flows_differ_on: str = ""

    @model_validator(mode="after")
    def _parts_fit(self) -> Manifest:
        if self.identity_digest != self.identity.digest():
            raise ValueError("the identity does not match its digest")
        measuring = self.identity.measuring
        if (versions := (measuring.version, measuring.rows)) != (known := (IDENTITY_VERSION, ROW_SCHEMA_VERSION)):
            raise ValueError(f"written with versions {versions} of identity and rows, but this version reads {known}")
        planned = [key for part in self.planned for key in part.samples]
        if len(planned) != len(self.samples) or set(planned) != self.samples.keys():
            raise ValueError("every sample must be in exactly one part of the plan")
        if (count := sum(map(Cells.count, self.planned))) > _MOST_CELLS:
            raise ValueError(f"{count} rows are planned, but a run has at most {_MOST_CELLS}")
        made = [cells for part in self.earlier for cells in part.made]
        if sum(map(Cells.count, made)) > count:
            raise ValueError("earlier environments made more rows than are planned")
        if not {key for cells in made for key in cells.samples} <= self.samples.keys():
            raise ValueError("an earlier environment made rows of other samples")
        return self

    @property
    def corruptions(self) -> tuple[str, ...]:
        """The corruptions of the plan."""
        return tuple(dict.fromkeys(name for part in self.planned for name in part.corruptions))

    @property
    def attacks(self) -> tuple[str, ...]:
        """The attacks of the plan."""
        return tuple(dict.fromkeys(name for part in self.planned for name in part.attacks))

    @property
    def severities(self) -> tuple[int, ...]:
        """The requested severities, ascending, without that of a stack that exists at a single one."""
        return tuple(sorted({level for levels in self._levels() for level in levels}))

    @property
    def uneven(self) -> bool:
        """Whether the corruptions were requested at different severities or on different samples, so that a mean over
        them mixes unlike conditions."""
        corruptions = [part.corruptions for part in self.planned]
        return any(other != corruptions[0] for other in corruptions) or len(self._levels(attacks=False)) > 1

    def _levels(self, attacks: bool = True) -> set[frozenset[int]]:
        """Return the sets of severities at which conditions were requested."""
        return {
            frozenset((*levels, *self.left_out.get(name, ())))
            for part in self.planned
            for name, levels in (*part.corruptions.items(), *(part.attacks.items() if attacks else ()))
            if name in part.attacks or condition_of(name).fixed_severity is None
        }

    def document(self) -> bytes:
        """Return the content of the file, without fields that have their default values."""
        return document_bytes(self.model_dump(mode="json", exclude_defaults=True))

    def shareable(self) -> Manifest:
        """Return the manifest for a record: without the user's attacks, the command line, the machines of a cluster,
        or any facts about the machine except its kind."""
        earlier = tuple(
            part.shareable().model_copy(update={"made": _without_own_attacks(part.made)}) for part in self.earlier
        )
        planned = _without_own_attacks(self.planned)
        environment = self.environment.shareable()
        return self.model_copy(
            update={"environment": environment, "earlier": earlier, "places": {}, "planned": planned}
        )

    def continued_in(self, here: Environment, cells: Collection[Cell]) -> Manifest:
        """Return the manifest of a run that has these rows and is continued in an environment."""
        if here.versions() == self.environment.versions():
            return self.model_copy(update={"environment": here})
        known = {cell for part in self.earlier for cells in part.made for cell in cells.every()}
        made = parts_of((cell for cell in cells if cell not in known and cell[0] in self.samples), self.attacks)
        last = EarlierEnvironment(**dict(self.environment), made=made) if made else None
        earlier = (*self.earlier, *([last] if last else []))
        return self.model_copy(update={"environment": here, "earlier": earlier})

    def without(self, keys: Collection[str]) -> Manifest:
        """Return the manifest without some of the samples."""
        left = (part.among(key for key in part.samples if key not in keys) for part in self.planned)
        return self.restricted(union(left), self.left_out)

    def restricted(self, planned: Sequence[Cells], left_out: Mapping[str, tuple[int, ...]]) -> Manifest:
        """Return the manifest of a run of only some of the cells."""
        keys = [key for part in planned for key in part.samples]
        left = set(keys)
        earlier = (
            part.model_copy(
                update={"made": union(cells.among(key for key in cells.samples if key in left) for cells in part.made)}
            )
            for part in self.earlier
        )
        update = {
            "samples": {key: self.samples[key] for key in keys},
            "earlier": tuple(part for part in earlier if part.made),
            "planned": tuple(planned),
            "left_out": dict(left_out),
        }
        return self.model_copy(update=update)

    @property
    def provenance(self) -> Provenance:
        """What the training data of the model mean for the results on the samples of all calls."""
        return self.provenance_on(self.identity.frames.benchmark)

    def provenance_on(self, benchmark: str) -> Provenance:
        """Return what the training data of the model mean for results on a benchmark with the same samples."""
        return provenance_of(self.training, benchmark, list(self.samples), self.identity.frames.protocol)


def _without_own_attacks(parts: Iterable[Cells]) -> tuple[Cells, ...]:
    return union(
        part.model_copy(update={"attacks": {k: v for k, v in part.attacks.items() if attack_spec(k).name in SHIPPED}})
        for part in parts
    )


def clips_of(records: Iterable[Mapping[str, Any]]) -> tuple[Clip, ...]:
    """Return the records of a dataset about its clips (`robustflow.data.datasets.dataset.FromClips.clip_records`)."""
    return tuple(Clip.model_validate_json(json.dumps(record)) for record in records)
