"""Read and write `manifest.json`, which describes a run, in a run's folder and in a record.

The file also contains the version of these classes and a digest of its content; it is rejected if either does not
match.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, JsonValue, ValidationError

from ..attacks.registry import SHIPPED, split_name
from ..errors import RunError, first_misfit
from ..links import not_a_link
from ..metrics.rows import ROW_SCHEMA_VERSION
from ..sealed import sealed
from ..text import plain
from ..validated import Untrusted
from .environment import Environment
from .identity import IDENTITY_VERSION, LONGEST_NAME, Identity, Text
from .provenance import Provenance

MANIFEST_SCHEMA = 3
_DEEPEST = 60

_Severity = Annotated[int, Field(ge=0, le=5)]
_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


class Selection(Untrusted):
    """Requested corruptions, attacks and severities; `subset` is "quick" for a benchmark's quick subset, whose means
    are estimates."""

    corruptions: tuple[Text, ...] = ()
    attacks: tuple[Text, ...] = ()
    severities: Annotated[tuple[_Severity, ...], Field(max_length=5)] = ()
    subset: Literal["", "quick"] = ""


class Clip(Untrusted):
    """The effects of one video corruption on a clip, as recorded by its dataset; `warnings` are shown to the user."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    warnings: tuple[str, ...] = ()


class Manifest(Untrusted):
    """The description of a run.

    Attributes:
        identity: everything that changes a row's numbers.
        identity_digest: digest of the identity.
        samples: name and size in bytes of each file, by sample key.
        file_digests: digest of each file, by sample key.
        provenance: training data of the model.
        selection: requested corruptions, attacks and severities.
        left_out: requested severities that do not exist on the severity scale, by corruption.
        name: name of the model in tables and figures, if one was given.
        started, finished: start and end times in UTC; `finished` is None until the run is finished.
        seconds: time in seconds, by kind of work.
        environment: versions and machine.
        places: number of units that each machine of a cluster computed; not in a record.
        clips: effects of the video corruptions on each clip.
    """

    identity: Identity
    identity_digest: _Digest
    samples: dict[Text, tuple[tuple[str, int], ...]]
    file_digests: dict[Text, tuple[_Digest, ...]] = {}
    provenance: Provenance
    selection: Selection
    left_out: dict[Text, tuple[_Severity, ...]] = {}
    name: Annotated[str, Field(max_length=LONGEST_NAME)] = ""
    started: str
    finished: str | None
    seconds: dict[str, float] = {}
    environment: Environment
    places: dict[str, int] = {}
    clips: tuple[Clip, ...] = ()

    @classmethod
    def read(cls, content: dict[str, Any]) -> Manifest:
        """Parse a manifest from the content of a file. The caller has to check the schema and the digest of the
        identity.

        Raises:
            ValidationError: the content has missing or invalid fields.
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
        known = tuple(name for name in self.selection.attacks if split_name(name)[0] in SHIPPED)
        selection = self.selection.model_copy(update={"attacks": known})
        return self.model_copy(update={"environment": environment, "places": {}, "selection": selection})

    def without(self, keys: Collection[str]) -> Manifest:
        """Return the manifest without some of the samples."""
        samples = {key: files for key, files in self.samples.items() if key not in keys}
        digests = {key: each for key, each in self.file_digests.items() if key not in keys}
        return self.model_copy(update={"samples": samples, "file_digests": digests})

    def judged(self) -> Manifest:
        """Return the manifest with its provenance updated for all samples of the run, including those added by a later
        call."""
        frames = self.identity.frames
        provenance = self.provenance.on(frames.benchmark, list(self.samples), frames.protocol)
        return self.model_copy(update={"provenance": provenance})


def clips_of(records: Iterable[Mapping[str, Any]]) -> tuple[Clip, ...]:
    """Return the records of a dataset about its clips (`robustflow.datasets.base.FromClips.clip_records`)."""
    return tuple(Clip.model_validate_json(json.dumps(record)) for record in records)


def read_manifest(path: Path) -> Manifest | None:
    """Read the manifest in a file; None if there is no such file.

    Raises:
        RunError: the file cannot be read, has a different schema, or has invalid fields. Nothing is repaired.
    """
    try:
        with open(path, encoding="utf-8", opener=not_a_link) as file:
            content = json.load(file)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise _damaged(path, " ".join(str(error).split())) from error
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema is not None and (schema != MANIFEST_SCHEMA or isinstance(schema, bool)):
        raise _other_version(path, f"run schema {plain(str(schema))}", MANIFEST_SCHEMA)
    if not isinstance(content, dict) or schema is None:
        raise _damaged(path, "it is not the manifest of a run")
    if _too_deep(content):
        raise _damaged(path, "its parts are nested too deeply")
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
        raise _other_version(path, f"version {measuring.rows} of the rows", ROW_SCHEMA_VERSION)
    if measuring.version != IDENTITY_VERSION:
        raise _other_version(path, f"version {measuring.version} of the identity", IDENTITY_VERSION)
    return manifest


def _changed(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} was changed after it was written ({why}); restore it from a backup, or choose another folder "
        "with --output"
    )


def _other_version(path: Path, what: str, here: int) -> RunError:
    return RunError(
        f"{path} was written with {what}, but this version reads {here}; choose another folder "
        "with --output, or use the version that wrote it"
    )


def _damaged(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} is damaged ({why}); restore it from a backup, or leave it and choose another folder with --output"
    )


def _too_deep(value: Any) -> bool:
    """Return whether lists and objects are nested more deeply than in any manifest that a run writes."""
    level = [value]
    for _ in range(_DEEPEST):
        values = [list(each.values()) if isinstance(each, dict) else each for each in level]
        level = [part for each in values if isinstance(each, list) for part in each]
        if not level:
            return False
    return True
