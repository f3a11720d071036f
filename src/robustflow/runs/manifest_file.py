"""`manifest.json`: written with a digest of its content; read only if it has this schema, the shape that a run writes,
and the content that was written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import RunError, first_misfit
from ..links import not_a_link
from ..metrics.rows import ROW_SCHEMA_VERSION
from ..sealed import sealed
from ..text import plain
from .identity import identity_digest

MANIFEST_SCHEMA = 2
_DEEPEST = 60

_Severity = Annotated[int, Field(ge=0, le=5)]


class _Shape(BaseModel):
    """The fields that are read; any others are kept."""

    model_config = ConfigDict(extra="allow", strict=True)


class _IdentityFields(_Shape):
    benchmark: str
    dataset: str
    protocol: dict[str, Any]
    model: dict[str, Any]
    seed: int
    variant: str
    allow_invalid: bool
    rows: int


class _SelectionFields(_Shape):
    corruptions: list[str]
    severities: list[_Severity]


class _ProvenanceFields(_Shape):
    setting: str
    trained_on: list[str] | None
    basis: str
    note: str = ""


class _EnvironmentFields(_Shape):
    packages: dict[str, str]


class _ManifestFields(_Shape):
    identity: _IdentityFields
    identity_digest: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    samples: dict[str, list[list[Any]]]
    selection: _SelectionFields
    provenance: _ProvenanceFields
    left_out: dict[str, list[_Severity]] = {}
    started: str = ""
    finished: str | None = None
    seconds: dict[str, float] = {}
    environment: _EnvironmentFields
    places: dict[str, int] = {}
    clips: list[dict[str, Any]] = []


def manifest_file(content: dict[str, Any]) -> dict[str, Any]:
    """The file for a manifest: its content with the schema and a digest of both.

    >>> manifest_file({"seed": 1}) == manifest_file(manifest_file({"seed": 1}))
    True
    """
    return sealed({**content, "schema": MANIFEST_SCHEMA})


def read_manifest(path: Path) -> dict[str, Any] | None:
    """The manifest in a file; None if there is no such file.

    Raises:
        RunError: it cannot be read, is of another schema, or has another shape. Nothing is repaired.
    """
    try:
        with open(path, encoding="utf-8", opener=not_a_link) as file:
            manifest = json.load(file)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise _damaged(path, " ".join(str(error).split())) from error
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema is not None and (schema != MANIFEST_SCHEMA or isinstance(schema, bool)):
        raise _other_version(path, f"run schema {plain(str(schema))}", MANIFEST_SCHEMA)
    if not isinstance(manifest, dict) or schema is None:
        raise _damaged(path, "it is not the manifest of a run")
    if _too_deep(manifest):
        raise _damaged(path, "its parts are nested too deeply")
    if manifest != sealed(manifest):
        raise _changed(path, "its content does not match its digest")
    try:
        _ManifestFields.model_validate(manifest)
    except ValidationError as error:
        raise _damaged(path, plain(first_misfit(error), 200)) from error
    if manifest["identity_digest"] != identity_digest(manifest["identity"]):
        raise _changed(path, "its identity does not match the digest beside it")
    if (rows := manifest["identity"]["rows"]) != ROW_SCHEMA_VERSION:
        raise _other_version(path, f"version {rows} of the rows", ROW_SCHEMA_VERSION)
    return manifest


def _changed(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} was changed after it was written ({why}); restore a copy of it, or choose another folder with --output"
    )


def _other_version(path: Path, what: str, here: int) -> RunError:
    return RunError(
        f"{path} was written with {what}, but this version reads {here}; choose another folder "
        "with --output, or use the version that wrote it"
    )


def _damaged(path: Path, why: str) -> RunError:
    return RunError(
        f"{path} is damaged ({why}); restore a copy of it, or leave it and choose another folder with --output"
    )


def _too_deep(value: Any) -> bool:
    """Whether lists and objects are nested deeper than any that a run writes."""
    level = [value]
    for _ in range(_DEEPEST):
        level = [part for each in level if isinstance(each, dict | list) for part in _parts(each)]
        if not level:
            return False
    return True


def _parts(value: dict[str, Any] | list[Any]) -> list[Any]:
    return list(value.values()) if isinstance(value, dict) else value
