"""Trust in the files of a run, which anyone may have changed: each is written with a digest, and used only if that
still matches. The one comparison between what a run has and what is measured now.

A document is JSON that contains the digest of its content. An array is followed by a digest of its bytes and of what
it was computed from; one that does not match counts as missing. Files and values computed from a run's rows are listed
in `.derived.json`, with digests of their bytes and of everything from which they were computed: rows, manifest, code.
One that does not match is computed again, so an unchanged run is shown without decoding a row. (The digest of a shard
is in its name, see `store`.)
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import cache
from itertools import chain
from math import isclose
from pathlib import Path
from stat import S_ISREG
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, TypeAdapter, ValidationError

from ..core.errors import DataError, RunError, first_misfit
from ..core.files import (
    digest_of_bytes,
    digest_of_value,
    json_bytes,
    read_bounded,
    sealed,
    sealed_bytes,
    unsealed,
    unsealed_bytes,
    write_bytes,
)
from ..core.text import plain
from ..metrics.regions import REGIONS

Content = TypeVar("Content", bound=BaseModel)
Value = TypeVar("Value")
Array = npt.NDArray[np.float32]

DERIVED = ".derived.json"
"""Name of the list of derived files and values."""
_VALUES = "values"
_NOT_SHOWN = ("rows", "clean", "manifest.json", "source.json", "summary.json", "report.html")
_LARGEST_DERIVED = 2**28


def document_bytes(content: Mapping[str, Any]) -> bytes:
    """Return JSON content as a document."""
    return json_bytes(sealed(content))


def parse_document(kind: type[Content], data: bytes, name: str | Path, remedy: str) -> Content:
    """Parse a document, or raise a RunError that names it and ends with the remedy."""
    content = unsealed(data)
    if content is None:
        raise RunError(name, f"damaged: its content does not match its digest; {remedy}")
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        raise RunError(name, f"{plain(first_misfit(error), 200)}; {remedy}") from error


def read_document(kind: type[Content], path: Path, largest: int, remedy: str) -> Content | None:
    """Read a document of limited size; None if there is no such file."""
    if not path.is_file():
        return None  # reading a pipe could block
    try:
        return parse_document(kind, read_bounded(path, largest, remedy), path, remedy)
    except DataError as error:
        raise RunError(path, f"cannot be read or is larger than {largest >> 20} MiB; {remedy}") from error


def write_array(path: Path, array: Array, made_of: str) -> None:
    """Store an array with the description of its inputs."""
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array, np.float32), allow_pickle=False)
    write_bytes(path, sealed_bytes(file.getvalue(), made_of), durable=False)  # a lost array is recomputed


def read_array(path: Path, made_of: str) -> Array | None:
    """Read an array stored earlier; None unless it is intact and was computed from the same inputs."""
    try:
        data = unsealed_bytes(path.read_bytes(), made_of)
        array = None if data is None else np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # NumPy's parser can raise any exception on a manipulated header
        return None
    return array if isinstance(array, np.ndarray) and array.dtype == np.float32 else None


_EQUAL = {
    "frames": ("frames_digest", "height", "width"),
    "group": ("group",),
    "ground truth": ("truth", "truth_digest"),
}
"""Columns that are equal whatever the model, by what differs if they are not."""
_TRUTH_SUMS = ("n_valid", "magnitude_sum", *(f"n_{region}" for region in REGIONS))
"""Columns that are also equal whatever the model, if it predicted every pixel."""
_MEANS = {
    "pred_magnitude_sum": "n_all",
    "rcre_all_sum": "n_all",
    "spread_sum": "n_all",
    "photometric_sum": "n_photometric",
    "epe_sum": "n_valid",
    "n_invalid": "height",
}
"""Sums that depend on the model, and what they are divided by."""
COMPARED = tuple(dict.fromkeys((*chain(*_EQUAL.values()), *_TRUTH_SUMS, *chain(*_MEANS.items()))))
"""The columns of a row that are compared."""
_TOLERANCE = 1e-3
"""Larger than the rounding differences between two runs on a GPU, smaller than the effect of a changed model."""


def row_difference(
    before: Mapping[str, Any], now: Mapping[str, Any], *, model: bool = True, relative: float = 0.0, pixels: float = 0.0
) -> str:
    """Return what differs between two measurements of one cell: "frames", "group", "ground truth", "flow", or "".

    Args:
        before: the earlier row.
        now: the row of a new measurement.
        model: whether the same model predicted both flows.
        relative, pixels: tolerances for the means of a flow's errors.
    """
    whole = all(row["n_all"] == row["height"] * row["width"] for row in (before, now))
    for what, columns in (*_EQUAL.items(), *((("ground truth", _TRUTH_SUMS),) if whole else ())):
        if any(before[column] != now[column] for column in columns):
            return what
    for total, count in _MEANS.items() if model else ():
        then, today = _mean(before, total, count), _mean(now, total, count)
        if then is None or today is None:
            close = then is today
        else:
            close = isclose(then, today, rel_tol=relative, abs_tol=pixels)
        if not close:
            return "flow"
    return ""


def check_same(before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise a RunError if a row that a run continues from differs from a new measurement of its cell."""
    what = row_difference(before, now, relative=_TOLERANCE)
    if what == "flow":
        raise RunError(
            before["sample"],
            "the model predicts a different flow on this sample than when this run measured it, although the model's "
            "name is the same: its code, a module that it imports or its weights have changed; restore the model, or "
            "choose a different folder with --output",
        )
    if what:
        raise RunError(
            before["sample"],
            f"this sample has different {what} than when this run measured it, although the digests of its files are "
            "the same; restore the data, or choose a different folder with --output",
        )


def _mean(row: Mapping[str, Any], total: str, count: str) -> float | None:
    """Return a row's mean; None if it was not measured, and infinity if no pixel was."""
    value: float | None = row[total]
    return None if value is None else value / row[count] if row[count] else float("inf")


class Derived:
    """The files and values that are computed from a run's rows."""

    def __init__(self, folder: Path, rows: str, manifest: bytes) -> None:
        self._folder = folder
        self._made_of = [rows, digest_of_bytes(manifest)]
        entry = self._listed().get(_VALUES)
        known = entry.get(_VALUES) if isinstance(entry, dict) and entry.get("source") == self._source() else None
        self._known: dict[str, Any] = known if isinstance(known, dict) else {}
        self._new = False

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def value(self, name: str, kind: type[Value], make: Callable[[], Value]) -> Value:
        """Return a value; compute it if it is missing or has a different type."""
        try:
            return TypeAdapter(kind).validate_python(self._known[name])
        except (KeyError, ValidationError):
            self._known[name], self._new = make(), True
            return self._known[name]

    def write_values(self) -> None:
        """Store the values computed since they were read."""
        if self._new:
            self._list(_VALUES, {"source": self._source(), _VALUES: self._known})
            self._new = False

    def write_file(
        self, name: str, make: Callable[[], bytes], *, shows_others: bool = False, made_with: str = ""
    ) -> bool:
        """Write a file, unless it is unchanged and was made from the same source and with the same options; the source
        includes the other files of the run if it shows them. Return whether it was written."""
        source, before = self._source(shows_others, made_with), _read(self._folder / name)
        if before is not None and self._listed().get(name) == _entry(source, before):
            return False
        data = make()
        write_bytes(self._folder / name, data)
        self._list(name, _entry(source, data))  # not of the file, which another process may replace
        return True

    def _source(self, shows_others: bool = False, made_with: str = "") -> str:
        """Return a hash of everything from which a file or value is made."""
        files = _files(self._folder, _NOT_SHOWN) if shows_others else []
        return digest_of_value([*self._made_of, files, code_digest(), made_with], size=16)

    def _listed(self) -> dict[str, Any]:
        """Read the list of derived files; empty if it is missing or damaged."""
        content: dict[str, Any] = json.loads(unsealed(_read(self._folder / DERIVED) or b"") or b"{}")
        return content

    def _list(self, name: str, entry: dict[str, Any]) -> None:
        write_bytes(self._folder / DERIVED, document_bytes({**self._listed(), name: entry}))


def _entry(source: str, data: bytes) -> dict[str, str]:
    return {"source": source, "digest": digest_of_bytes(data)}


def _read(path: Path) -> bytes | None:
    try:
        return read_bounded(path, _LARGEST_DERIVED, "") if path.is_file() else None
    except DataError:
        return None


def _files(folder: Path, left_out: Collection[str] = ()) -> list[tuple[str, int, int]]:
    """Return name, size and modification time of the files in a folder, except hidden and compiled ones."""
    out = []
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if parts[0] in left_out or any(part.startswith((".", "__pycache__")) for part in parts):
            continue
        with suppress(OSError):  # deleted in the meantime
            stat = path.stat()
            if S_ISREG(stat.st_mode):
                out.append(("/".join(parts), stat.st_size, stat.st_mtime_ns))
    return out


@cache
def code_digest() -> str:
    """Return a hash of the installed package: name, size and modification time of its files."""
    return digest_of_value(_files(Path(__file__).parents[1]), size=16)
