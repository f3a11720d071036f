"""The manifest of a run, `manifest.json` in its folder and in a record: what was asked for, on which data, and when."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, JsonValue, model_validator

from ..attacks.registry import SHIPPED, attack_spec
from ..core.types import Untrusted
from ..corruptions.condition import condition_of
from ..data.benchmarks.setting import Provenance, provenance_of
from ..metrics.rows import ROW_SCHEMA_VERSION
from ..models.provenance import Training
from .cells import Cell, Cells, Levels, parts_of, union
from .identity import IDENTITY_VERSION, LONGEST_NAME, Environment, Identity, Text
from .trust import document_bytes

LARGEST_MANIFEST = 2**30
"""Maximum size of the file in bytes: of a run with millions of samples."""

_MOST_CELLS = 20_000_000
"""Maximum number of rows of a run: four times those of the largest dataset under every corruption."""

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


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
