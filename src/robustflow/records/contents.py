"""The contents of a record: `record.json`, and the run's manifest without details that identify a machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, field_validator

from ..errors import DataError, RunError, first_misfit
from ..runs.manifest import Manifest
from ..text import plain
from ..validated import Untrusted
from .text import holds_path, texts

FORMAT = "robustflow-record"
VERSION = 2
"""Version of a record's contents, incremented when the contents or their meaning change."""

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


class PackedEntry(Untrusted):
    """Size and hash of an entry of the file."""

    bytes: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Record(Untrusted):
    """`record.json`: the format of the file, and its submitter; author, link and description are arbitrary plain
    text."""

    format: Literal["robustflow-record"] = "robustflow-record"
    version: Annotated[int, Field(ge=VERSION, le=VERSION)] = VERSION
    run: _Digest
    complete: bool
    entries: dict[str, PackedEntry]
    author: Annotated[str, Field(max_length=200)] = ""
    link: Annotated[str, Field(max_length=500)] = ""
    description: Annotated[str, Field(max_length=2000)] = ""

    @field_validator("link")
    @classmethod
    def _web_address(cls, link: str) -> str:
        if link and not link.startswith("https://"):
            raise ValueError("a link must begin with https://")
        return link


_Given = TypeVar("_Given")
_Model = TypeVar("_Model")


def parsed(parse: Callable[[_Given], _Model], given: _Given, name: str) -> _Model:
    """Parse a file's content into one of these models.

    Raises:
        DataError: the content does not match the model; the message names the first mismatch.
    """
    try:
        return parse(given)
    except ValidationError as error:
        raise DataError(f"{name}: {plain(first_misfit(error), 200)} ({error.error_count()} in total)") from error


def check_version(record: dict[str, Any]) -> None:
    """Check that this version can read a `record.json`, before any other field is used.

    Raises:
        DataError: the format is unknown, or its version is different.
    """
    version = record.get("version")
    if record.get("format") != FORMAT or isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise DataError("record.json is not a record of a run; give a file written by 'robustflow record pack'")
    if version != VERSION:
        remedy = "upgrade robustflow to read it" if version > VERSION else "use the version that packed it"
        raise DataError(
            f"record.json has record version {version}, but this RobustFlow reads version {VERSION}: {remedy}"
        )


def shareable_manifest(manifest: Manifest, keep_paths: bool = False) -> Manifest:
    """Return a run's manifest as stored in a record: file names without folders, kind of machine, versions, times.

    Raises:
        RunError: a text contains a path on this machine, but is part of the run's identity and cannot be left out;
            `keep_paths` allows such texts.
    """
    out = manifest.judged().shareable()
    for where, text in () if keep_paths else texts(out.record()):
        if holds_path(text):
            raise RunError(
                f"manifest.json: {where or 'a name'} contains '{plain(text, 60)}', a path on this machine that would "
                "be published; run again with a relative path, or give --keep-paths"
            )
    return out
