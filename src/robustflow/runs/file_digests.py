"""A digest of every file that a run's samples are read from, so that a later change of a single byte is noticed.

Many formats (BMP, PPM, uncompressed TIFF, .flo) cannot detect a changed byte themselves.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ..errors import RunError

_THREADS = 4
"""Hashing releases the interpreter's lock, and disks serve several requests at a time faster than one by one."""


def file_digests(files: Mapping[str, Iterable[Path]]) -> dict[str, list[str]]:
    """For each sample the digests of its files, 16 hexadecimal digits each, in their order; each file is read once.

    Args:
        files: the files of each sample.

    Raises:
        RunError: one cannot be read.

    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "a.flo"
    >>> _ = path.write_bytes(b"flow")
    >>> file_digests({"a": [path]})
    {'a': ['197022cced1f7f35']}
    """
    listed = {key: list(paths) for key, paths in files.items()}
    once = list(dict.fromkeys(path for paths in listed.values() for path in paths))
    with ThreadPoolExecutor(_THREADS) as pool:
        digests = dict(zip(once, pool.map(_digest, once), strict=True))
    return {key: [digests[path] for path in paths] for key, paths in listed.items()}


def _digest(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=8)).hexdigest()
    except OSError as error:
        raise RunError(f"cannot read {error.filename}: {error.strerror}") from error
