"""Read and write `manifest.json`, which describes a run, in a run's folder and in a record. List the files from
which a sample is read: those of the pair, of the frames around it, and of its depth.

The file also contains the version of these classes and a digest of its content; it is rejected if either does not
match.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, JsonValue, ValidationError, model_validator

from ..attacks.registry import SHIPPED, split_name
from ..core.errors import RunError, first_misfit
from ..core.files import sealed
from ..core.plugins import called
from ..core.text import plain
from ..core.types import Untrusted
from ..corruptions.stack import levels_of
from ..data.datasets.base import Clips, Dataset, Depths
from ..data.datasets.clips import ContextFrames
from ..metrics.rows import ROW_SCHEMA_VERSION
from ..models.base import Window
from .cells import Cells, Levels, union
from .identity import IDENTITY_VERSION, LONGEST_NAME, Environment, Identity, Provenance, Text

MANIFEST_SCHEMA = 4

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


class Clip(Untrusted):
    """The effects of one video corruption on a clip, as recorded by its dataset; `warnings` are shown to the user."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    warnings: tuple[str, ...] = ()


class Manifest(Untrusted):
    """The description of a run."""

    identity: Identity
    identity_digest: _Digest
    samples: dict[Text, tuple[tuple[str, int], ...]]
    file_digests: dict[Text, tuple[_Digest, ...]] = {}
    provenance: Provenance
    planned: tuple[Cells, ...]
    left_out: dict[Text, Levels] = {}
    name: Annotated[str, Field(max_length=LONGEST_NAME)] = ""
    started: str
    finished: str | None
    seconds: dict[str, float] = {}
    environment: Environment
    places: dict[str, int] = {}
    clips: tuple[Clip, ...] = ()

    @model_validator(mode="after")
    def _samples_fit(self) -> Manifest:
        planned = [key for part in self.planned for key in part.samples]
        if len(planned) != len(self.samples) or set(planned) != self.samples.keys():
            raise ValueError("every sample must be in exactly one part of the plan")
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
            if name in part.attacks or not levels_of(name, ())
        }

    @classmethod
    def read(cls, content: dict[str, Any]) -> Manifest:
        """Parse a manifest from the content of a file. The caller has to check the schema and the digest of the
        identity.
        """
        body = {name: value for name, value in content.items() if name not in ("schema", "digest")}
        return cls.model_validate_json(json.dumps(body))

    def record(self) -> dict[str, Any]:
        """Return the content of the file, without its digest (`sealed`) and without fields that have their default
        values."""
        return {**self.model_dump(mode="json", exclude_defaults=True), "schema": MANIFEST_SCHEMA}

    def shareable(self) -> Manifest:
        """Return the manifest for a record: without the user's attacks, the command line, the machines of a cluster,
        or any facts about the machine except its kind."""
        machine = self.environment.machine
        kind = machine.model_copy(update={"system": machine.system.partition("-")[0]})
        environment = self.environment.model_copy(update={"machine": kind, "command": ()})
        planned = union(part.model_copy(update={"attacks": _shipped(part.attacks)}) for part in self.planned)
        return self.model_copy(update={"environment": environment, "places": {}, "planned": planned})

    def without(self, keys: Collection[str]) -> Manifest:
        """Return the manifest without some of the samples."""
        left = (part.among(key for key in part.samples if key not in keys) for part in self.planned)
        return self.restricted(union(left), self.left_out)

    def restricted(self, planned: Sequence[Cells], left_out: Mapping[str, tuple[int, ...]]) -> Manifest:
        """Return the manifest of a run of only some of the cells."""
        keys = [key for part in planned for key in part.samples]
        update = {
            "samples": {key: self.samples[key] for key in keys},
            "file_digests": {key: self.file_digests[key] for key in keys if key in self.file_digests},
            "planned": tuple(planned),
            "left_out": dict(left_out),
        }
        return self.model_copy(update=update).judged()

    def judged(self) -> Manifest:
        """Return the manifest with its provenance updated for all samples of the run, including those added by a later
        call."""
        frames = self.identity.frames
        provenance = self.provenance.on(frames.benchmark, list(self.samples), frames.protocol)
        return self.model_copy(update={"provenance": provenance})


def _shipped(attacks: Mapping[str, Levels]) -> dict[str, Levels]:
    return {name: levels for name, levels in attacks.items() if split_name(name)[0] in SHIPPED}


def clips_of(records: Iterable[Mapping[str, Any]]) -> tuple[Clip, ...]:
    """Return the records of a dataset about its clips (`robustflow.data.datasets.base.FromClips.clip_records`)."""
    return tuple(Clip.model_validate_json(json.dumps(record)) for record in records)


def read_manifest(path: Path) -> Manifest | None:
    """Read the manifest in a file; None if there is no such file."""
    try:
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise _damaged(path, " ".join(str(error).split())) from error
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema is not None and (schema != MANIFEST_SCHEMA or isinstance(schema, bool)):
        raise _unreadable_version(path, f"run schema {plain(str(schema))}", MANIFEST_SCHEMA)
    if not isinstance(content, dict) or schema is None:
        raise _damaged(path, "it is not the manifest of a run")
    if content != sealed(content):
        raise _changed(path, "its content does not match its digest")
    try:
        manifest = Manifest.read(content)
    except ValidationError as error:
        raise _damaged(path, plain(first_misfit(error), 200)) from error
    if manifest.identity_digest != manifest.identity.digest():
        raise _changed(path, "its identity does not match its stored digest")
    measuring = manifest.identity.measuring
    if measuring.rows != ROW_SCHEMA_VERSION:
        raise _unreadable_version(path, f"version {measuring.rows} of the rows", ROW_SCHEMA_VERSION)
    if measuring.version != IDENTITY_VERSION:
        raise _unreadable_version(path, f"version {measuring.version} of the identity", IDENTITY_VERSION)
    return manifest


def _changed(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} was changed after it was written ({why}); restore it from a backup, or choose another folder "
        "with --output"
    )


def _unreadable_version(path: Path, what: str, here: int) -> RunError:
    return RunError(
        f"{path} was written with {what}, but this version reads {here}; choose another folder "
        "with --output, or use the version that wrote it"
    )


def _damaged(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} is damaged ({why}); restore it from a backup, or leave it and choose another folder with --output"
    )


def files_of_sample(dataset: Dataset, key: str, window: Window | None, depths: Depths | None) -> list[Path]:
    """Return the files from which a sample is read; files used only for depth come last."""
    files: list[Path] = called(f"the dataset failed in files('{key}')", lambda: dataset.files(key))
    if window is not None:
        assert isinstance(dataset, Clips)
        files = list(dict.fromkeys([*files, *ContextFrames(dataset, window).files(key)]))
    of_depth = [] if depths is None else [path for path in depths.depth_files(key) if path not in files]
    return [*files, *of_depth]
