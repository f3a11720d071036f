"""Open a model file, which is treated as an untrusted download. Importable without the torch extra."""

from __future__ import annotations

import codecs
import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..core.errors import ModelError, UsageError

_NO_MODEL = {
    rb"<[!?a-zA-Z]": "a web page: the download returned a login or error page instead of the file",
    rb"version https://git-lfs": "a Git LFS pointer: fetch the file itself with `git lfs pull`",
}


def require_file(path: Path, what: str) -> None:
    """Raise an error if a file is missing, before the library that reads it is imported."""
    if not path.exists():
        raise ModelError(path, f"no such {what}")


@contextmanager
def opened(path: Path, sha256: str | None = None) -> Iterator[tuple[BinaryIO, str]]:
    """Open a file, and return it (positioned at its start) with its SHA-256 as 64 hexadecimal digits."""
    try:
        if not (path.is_file() or path.is_dir()) and path.exists():
            raise ModelError(path, "a pipe or a device, not a file; pass the path of a checkpoint")
        with path.open("rb") as file:
            _refuse_other_files(path, file)
            file.seek(0)
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            if sha256 is not None:
                _check_hash(path, digest, sha256)
            file.seek(0)
            yield file, digest
    except FileNotFoundError:
        raise ModelError(path, "no such checkpoint; put the authors' file there, or pass its path") from None
    except OSError as error:
        raise ModelError(path, f"cannot be read: {error.strerror or error}; pass the path of a checkpoint") from None


def damaged(path: Path, error: Exception) -> ModelError:
    """Return the error for a file that cannot be read, with the first line of the library's message."""
    first_line = next(iter(str(error).splitlines()), "it ends early")
    return ModelError(
        path,
        f"truncated or damaged ({path.stat().st_size} bytes; {type(error).__name__}: {first_line[:120]}); "
        "copy or download it again and compare its size with that of the original",
    )


def _refuse_other_files(path: Path, file: BinaryIO) -> None:
    head = file.read(1024).removeprefix(codecs.BOM_UTF8).lstrip()
    if not head:
        raise ModelError(path, "the file is empty; copy or download it again")
    for start, what in _NO_MODEL.items():
        if re.match(start, head):
            raise ModelError(path, f"the file is {what}; download the checkpoint itself, for example in a browser")


def _check_hash(path: Path, digest: str, expected: str) -> None:
    if not re.fullmatch("[0-9a-fA-F]{8,64}", str(expected)) or not isinstance(expected, str):
        raise UsageError(
            "sha256", f"{expected} is not a SHA-256 (64 hexadecimal digits) or a prefix of at least 8 digits"
        )
    if not digest.startswith(expected.lower()):
        raise ModelError(
            path, f"its SHA-256 is {digest} instead of {expected}; the file is different or damaged: download it again"
        )
