"""The contents of a record, as validated data: `record.json`, and the manifest without anything that identifies a
machine."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, JsonValue, ValidationError, field_validator, model_validator

from ..benchmarks.setting import manifest_provenance
from ..errors import DataError, RunError, first_misfit
from ..models.provenance import Setting
from ..runs.identity import LONGEST_NAME
from ..runs.manifest_file import MANIFEST_SCHEMA
from ..text import plain
from ..validated import Untrusted
from .rows_text import MOST_ROWS
from .text import holds_path, texts

FORMAT = "robustflow-record"
VERSION = 1
"""Incremented when the contents of a record, or their meaning, change."""

_Text = Annotated[str, Field(min_length=1, max_length=500)]
_Severity = Annotated[int, Field(ge=0, le=5)]
_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


class PackedEntry(Untrusted):
    """Size and hash of an entry of the file."""

    bytes: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Record(Untrusted):
    """`record.json`: what the file is, and who submits it; author, link and description are arbitrary plain text."""

    format: Literal["robustflow-record"] = "robustflow-record"
    version: Annotated[int, Field(ge=1, le=VERSION)] = VERSION
    run: _Digest
    complete: bool
    entries: dict[str, PackedEntry]
    author: Annotated[str, Field(max_length=200)] = ""
    link: Annotated[str, Field(max_length=500)] = ""
    description: Annotated[str, Field(max_length=2000)] = ""

    @field_validator("link")
    @classmethod
    def _web_address(cls, link: str) -> str:
        if link and not link.startswith(("https://", "http://")):
            raise ValueError("a link must begin with https://")
        return link


class Identity(Untrusted):
    """What changes a row's numbers; see `robustflow.runs.plan.Plan.identity`."""

    version: int
    benchmark: _Text
    dataset: _Text
    protocol: dict[str, JsonValue]
    model: dict[str, JsonValue]
    seed: int
    variant: _Text
    allow_invalid: bool
    streams: int
    rows: int
    severity_scale: _Text | None = None
    psf: _Text | None = None
    window: dict[str, JsonValue] | None = None
    corruptions: dict[_Text, _Text] | None = None
    common_draws: bool | None = None


class Selection(Untrusted):
    """Requested corruptions and severities."""

    corruptions: Annotated[list[_Text], Field(min_length=1, max_length=1000)]
    severities: Annotated[list[_Severity], Field(min_length=1, max_length=5)]


class Provenance(Untrusted):
    """What the manifest states about the model's training."""

    setting: Setting
    trained_on: Annotated[list[_Text], Field(max_length=100)] | None
    basis: _Text
    note: str = ""


class Machine(Untrusted):
    """What kind of machine, not which."""

    system: Annotated[str, Field(max_length=40)]
    processor: Annotated[str, Field(max_length=40)]
    cores: int | None


class Environment(Untrusted):
    """Versions of what can change a number."""

    python: Annotated[str, Field(max_length=40)]
    packages: Annotated[dict[_Text, _Text], Field(max_length=100)]
    machine: Machine


class Manifest(Untrusted):
    """`manifest.json` of a record: that of the run, without its command line and the machine's name and version."""

    run_schema: Annotated[int, Field(alias="schema", ge=MANIFEST_SCHEMA, le=MANIFEST_SCHEMA)]
    identity: Identity
    identity_digest: _Digest
    samples: Annotated[dict[_Text, list[tuple[_Text, int]]], Field(min_length=1, max_length=MOST_ROWS)]
    file_digests: Annotated[dict[_Text, list[_Digest]], Field(max_length=MOST_ROWS)] = {}
    provenance: Provenance
    selection: Selection
    left_out: Annotated[dict[_Text, list[_Severity]], Field(max_length=1000)] = {}
    name: Annotated[str, Field(max_length=LONGEST_NAME)] = ""
    started: Annotated[str, Field(max_length=40)]
    finished: Annotated[str, Field(max_length=40)] | None
    seconds: Annotated[dict[_Text, float], Field(max_length=20)]
    environment: Environment
    clips: Annotated[list[dict[str, JsonValue]], Field(max_length=100_000)] = []

    @model_validator(mode="after")
    def _not_endless(self) -> Manifest:
        planned = len(self.samples) * (1 + len(self.selection.corruptions) * len(self.selection.severities))
        if planned > MOST_ROWS:
            raise ValueError(f"{planned} rows are planned; a record holds at most {MOST_ROWS}")
        return self


_Model = TypeVar("_Model", bound=BaseModel)


def validated(kind: type[_Model], data: bytes, name: str) -> _Model:
    """JSON text as one of the models above.

    Raises:
        DataError: it has another shape; the first mismatch is named.
    """
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        raise DataError(f"{name}: {plain(first_misfit(error), 200)} ({error.error_count()} misfit)") from error


def check_version(record: dict[str, Any], name: str) -> None:
    """Check that this version can read a `record.json`, before anything else in it is used.

    Raises:
        DataError: another format, or a newer version of it.
    """
    version = record.get("version")
    if record.get("format") != FORMAT or isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise DataError(f"{name} is not a record of a run; give a file that 'robustflow pack' wrote")
    if version > VERSION:
        raise DataError(
            f"{name} is a record of version {version}, but this version reads {VERSION}: upgrade robustflow to read it"
        )


def shareable_manifest(manifest: dict[str, Any], keep_paths: bool = False) -> dict[str, Any]:
    """A run's manifest in the form for a record: names of files without folders, kind of machine, versions, times.

    The command line is left out because it contains paths, and so are the machine's name and system version.

    Raises:
        RunError: a text in it contains a path of this machine, but is part of the run's identity and cannot be left
            out; `keep_paths` packs it nevertheless.
    """
    kept = {field.alias or name for name, field in Manifest.model_fields.items()}
    out = {name: value for name, value in manifest.items() if name in kept}
    out["provenance"] = manifest_provenance(manifest)
    environment = manifest["environment"]
    machine = environment["machine"]
    out["environment"] = {
        "python": environment["python"],
        "packages": environment["packages"],
        "machine": {
            "system": str(machine["system"]).partition("-")[0],
            "processor": machine["processor"],
            "cores": machine["cores"],
        },
    }
    for where, text in () if keep_paths else texts(out):
        if holds_path(text):
            raise RunError(
                f"manifest.json: {where or 'a name'} holds '{plain(text, 60)}', a path of this machine that would be "
                "published; run again from a relative path, or give --keep-paths"
            )
    return out
