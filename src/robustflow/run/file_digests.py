"""Compute a digest of every file from which a run's samples are read, to detect any later change. Store arrays that
can be recomputed: clean flows of samples in progress, and perturbations of trained attacks.

Many formats (BMP, PPM, uncompressed TIFF, .flo) have no checksum, and JPEG and WebP detect few errors. A dataset's
folder may contain a list of digests, `digests.b2sum`, written by `robustflow prepare digests` and also readable by
`b2sum --check`. A run compares every file that it reads with the nearest list in a parent folder, so a copied dataset
is checked when it is used, at no extra cost.

A file contains a NumPy array, followed by 16 bytes: the digest of the array and of a description of its inputs. If the
digest does not match (truncated or changed file, or different inputs), the file counts as missing.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError, RunError
from ..core.files import sealed_bytes, unsealed_bytes, write_bytes
from ..core.text import counted, plain

DIGEST_LIST = "digests.b2sum"
"""File name of the list of digests in a dataset's folder."""

_THREADS = 4
"""Number of threads that read files: hashing releases the GIL, and disks are faster with several requests at a time."""
_LARGEST_LIST = 2**30
_LINE = re.compile(r"([0-9a-f]{16})  ([^\\\n]+)")


def file_digests(files: Mapping[str, Iterable[Path]]) -> dict[str, list[str]]:
    """Return the digests of each sample's files in order, 16 hexadecimal digits each; each file is read once."""
    listed = {key: list(paths) for key, paths in files.items()}
    digests = dict(_digests(path for paths in listed.values() for path in paths))
    return {key: [digests[path] for path in paths] for key, paths in listed.items()}


def check_listed(files: Mapping[Path, str | None]) -> None:
    """Compare files with the digests in the nearest `DIGEST_LIST` in a parent folder; files without a list pass."""
    nearest: dict[Path, Path | None] = {}
    lists: dict[Path, dict[str, str]] = {}
    wanted: dict[Path, str] = {}
    unlisted: dict[Path, list[Path]] = {}
    for path in files:
        folder = _nearest_list(path.absolute().parent, nearest)
        if folder is None:
            continue
        if folder not in lists:
            lists[folder] = read_list(folder)
        digest = lists[folder].get(path.absolute().relative_to(folder).as_posix())
        if digest is None:
            unlisted.setdefault(folder, []).append(path)
        else:
            wanted[path] = digest
    known = {path: digest for path, digest in files.items() if digest is not None}
    known |= dict(_digests(path for path in wanted if path not in known))
    differing = [path for path, digest in wanted.items() if known[path] != digest]
    if differing:
        folder = nearest[differing[0].absolute().parent]
        raise DataError(
            f"{differing[0]} does not match its digest in the {DIGEST_LIST} of {folder} ({len(differing)} of "
            f"{counted(len(wanted), 'file')} differ); copy the data again, or, if the change is intended, write the "
            f"list again with robustflow prepare digests --data {folder} --overwrite"
        )
    for folder, paths in unlisted.items():
        warnings.warn(
            f"{folder / DIGEST_LIST} does not list {counted(len(paths), 'file')} that the run reads ({paths[0].name}, "
            f"...), so not every file can be checked; write it again with robustflow prepare digests --data {folder} "
            "--overwrite",
            stacklevel=2,
        )


def is_under_a_list(folder: Path) -> bool:
    """Return whether a folder or one of its parents contains a `DIGEST_LIST`."""
    return _nearest_list(folder.absolute(), {}) is not None


def listed_files(folder: Path) -> list[str]:
    """Return the relative names of all files in a folder and its subfolders, sorted, without hidden files and the list
    itself.
    """
    names = [path.relative_to(folder).as_posix() for path in sorted(_files_below(folder, set()))]
    for name in names:
        if "\n" in name or "\\" in name:
            raise DataError(folder, f"the name {plain(name)} contains a line break or a backslash; rename the file")
    return names


def digests_in(folder: Path, names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield the name and digest of some files of a folder, in order."""
    return ((path.relative_to(folder).as_posix(), digest) for path, digest in _digests(map(folder.joinpath, names)))


def write_list(folder: Path, digests: Mapping[str, str]) -> Path:
    """Write the `DIGEST_LIST` of a folder, and return its path."""
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))
    write_bytes(folder / DIGEST_LIST, text.encode(errors="surrogateescape"))
    return folder / DIGEST_LIST


def read_list(folder: Path) -> dict[str, str]:
    """Read the digests in the `DIGEST_LIST` of a folder, by file name."""
    path = folder / DIGEST_LIST
    try:
        if path.stat().st_size > _LARGEST_LIST:
            raise DataError(path, f"larger than {_LARGEST_LIST >> 20} MiB, too large for a list of digests; delete it")
        lines = path.read_bytes().decode(errors="surrogateescape").removesuffix("\n").split("\n")
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); check its permissions") from error
    matches = [_LINE.fullmatch(line) for line in lines]
    if None in matches:
        raise DataError(
            path,
            f"line {matches.index(None) + 1} is not a digest and a name; write the list again with robustflow "
            f"prepare digests --data {folder} --overwrite",
        )
    return {match[2]: match[1] for match in matches if match}


def _nearest_list(folder: Path, known: dict[Path, Path | None]) -> Path | None:
    """Return the nearest folder with a `DIGEST_LIST`, among a folder and its parents; `known` caches the results."""
    if folder not in known:
        above = folder.parent
        here = (folder / DIGEST_LIST).is_file()
        known[folder] = folder if here else None if above == folder else _nearest_list(above, known)
    return known[folder]


def _files_below(folder: Path, passed: set[str]) -> Iterator[Path]:
    """Yield the files that a list covers; a folder reached twice through links is visited once."""
    if (real := os.path.realpath(folder)) in passed:
        return
    passed.add(real)
    for path in folder.iterdir():
        if path.name.startswith(".") or path.name == DIGEST_LIST:
            continue
        if path.is_dir():
            yield from _files_below(path, passed)
        elif path.is_file():
            yield path


def _digests(paths: Iterable[Path]) -> Iterator[tuple[Path, str]]:
    """Return each file with its digest; each file is read once."""
    unique = list(dict.fromkeys(paths))
    with ThreadPoolExecutor(_THREADS) as pool:
        yield from zip(unique, pool.map(_digest, unique), strict=True)


def _digest(path: Path) -> str:
    if not path.is_file():
        raise RunError(path, "missing, or not a regular file; restore or remove it")
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=8)).hexdigest()
    except OSError as error:
        raise RunError(f"cannot read {error.filename}: {error.strerror}") from error


Array = npt.NDArray[np.float32]


def write_array(path: Path, array: Array, made_of: str) -> None:
    """Store an array."""
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array, np.float32), allow_pickle=False)
    write_bytes(path, sealed_bytes(file.getvalue(), made_of), durable=False)  # a lost array is recomputed


def read_array(path: Path, made_of: str) -> Array | None:
    """Read an array stored earlier; None unless it is intact and was computed from the same inputs."""
    try:
        data = unsealed_bytes(path.read_bytes(), made_of)
    except OSError:
        return None
    if data is None:
        return None
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # NumPy's parser can raise any exception on a manipulated header
        return None
    return array if isinstance(array, np.ndarray) and array.dtype == np.float32 else None
