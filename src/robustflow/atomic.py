"""Write a file so that a reader sees the old one, the whole new one, or none."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from .errors import DataError


def write_bytes(path: Path, data: bytes) -> None:
    """Put `data` at `path`: a hidden file in the same folder first, then a rename.

    Raises:
        DataError: the folder does not exist or cannot be written, or the disk is full; `path` is as it was before.

    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> write_bytes(folder / "a.bin", b"whole")
    >>> [file.name for file in folder.iterdir()]
    ['a.bin']
    """
    temporary = path.with_name(f".partial-{secrets.token_hex(4)}-{path.name}")
    try:
        with open(temporary, "xb") as file:
            file.write(data)
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise DataError(f"cannot write {path}: {reason}; choose a folder that exists and has room") from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
