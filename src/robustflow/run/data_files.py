"""The files from which a run's samples are read, and digests of them, to detect any later change.

Many formats (BMP, PPM, uncompressed TIFF, .flo) have no checksum, and JPEG and WebP detect few errors. A dataset's
folder may contain a list of digests, `digests.b2sum`, written by `robustflow prepare digests` and also readable by
`b2sum --check`. A run compares every file that it reads with the nearest list in a parent folder, so a copied dataset
is checked when it is used, at no extra cost.
"""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

from ..core.errors import DataError, RunError
from ..core.files import read_bounded, write_bytes
from ..core.plugins import called
from ..core.text import counted, plain
from ..data.datasets.clips import ContextFrames
from ..data.datasets.dataset import Clips, Dataset, Depths
from ..models.protocols import Window

DIGEST_LIST = "digests.b2sum"
"""File name of the list of digests in a dataset's folder."""

_THREADS = 4
"""Number of threads that read files: hashing releases the GIL, and disks are faster with several requests at a time."""
_LARGEST_LIST = 2**30
_LINE = re.compile(r"([0-9a-f]{16})  ([^\\\n]+)")
_REWRITE = "write it again with robustflow prepare digests --data FOLDER --overwrite"


def files_of_sample(dataset: Dataset, key: str, window: Window | None, depths: Depths | None) -> list[Path]:
    """Return the files of a sample: of the pair, of the frames around it and, last, those only of its depth."""
    files: list[Path] = called(f"the dataset '{dataset.name}'", f"files('{key}')", lambda: dataset.files(key))
    if window is not None:
        assert isinstance(dataset, Clips)
        files = list(dict.fromkeys([*files, *ContextFrames(dataset, window).files(key)]))
    return files if depths is None else list(dict.fromkeys([*files, *depths.depth_files(key)]))


def file_digests(files: Mapping[str, Iterable[Path]]) -> dict[str, list[str]]:
    """Return the digests of each sample's files in order, 16 hexadecimal digits each; each file is read once."""
    listed = {key: list(paths) for key, paths in files.items()}
    digests = dict(_digests(path for paths in listed.values() for path in paths))
    return {key: [digests[path] for path in paths] for key, paths in listed.items()}


def check_listed(known: Mapping[Path, str], more: Iterable[Path] = ()) -> None:
    """Compare files, by their digests if these are known, with the nearest `DIGEST_LIST` in a parent folder; files
    without a list pass. `more` is read only if there is a list."""
    listed = cache(read_list)

    @cache
    def nearest(folder: Path) -> Path | None:
        return next((each for each in (folder, *folder.parents) if (each / DIGEST_LIST).is_file()), None)

    if not any(nearest(path.absolute().parent) for path in known):
        return
    wanted: dict[Path, str] = {}
    unlisted: dict[Path, list[Path]] = {}
    for path in dict.fromkeys((*known, *more)):
        if (folder := nearest(path.absolute().parent)) is None:
            continue
        if digest := listed(folder).get(path.absolute().relative_to(folder).as_posix()):
            wanted[path] = digest
        else:
            unlisted.setdefault(folder, []).append(path)
    digests = {**known, **dict(_digests(path for path in wanted if path not in known))}
    if differing := [path for path, digest in wanted.items() if digests[path] != digest]:
        of = f"({len(differing)} of {counted(len(wanted), 'file')} differ)"
        raise DataError(
            differing[0],
            f"does not match its digest in the {DIGEST_LIST} of {nearest(differing[0].absolute().parent)} {of}; "
            f"copy the data again, or, if the change is intended, {_REWRITE}",
        )
    for folder, paths in unlisted.items():
        warnings.warn(
            f"{folder / DIGEST_LIST} does not list {counted(len(paths), 'file')} that the run reads ({paths[0].name}, "
            f"...), so not every file can be checked; {_REWRITE}",
            stacklevel=2,
        )


def listed_files(folder: Path) -> list[str]:
    """Return the relative names of all files below a folder, sorted, without hidden files and the list itself."""
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
    text = read_bounded(path, _LARGEST_LIST, "check its permissions").decode(errors="surrogateescape")
    matches = [_LINE.fullmatch(line) for line in text.removesuffix("\n").split("\n")]
    if None in matches:
        raise DataError(path, f"line {matches.index(None) + 1} is not a digest and a name; {_REWRITE}")
    return {match[2]: match[1] for match in matches if match}


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
