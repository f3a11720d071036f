"""Read files of limited size."""

from __future__ import annotations

from pathlib import Path

from .errors import DataError


def read_bounded(path: Path, largest: int, remedy: str) -> bytes:
    """Read a whole file that may be untrusted. No more than its maximum size is read, whatever size it claims to have.

    >>> len(read_bounded(Path(__file__), 2**16, "reinstall robustflow")) > 100
    True
    """
    try:
        with open(path, "rb") as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror or error}); {remedy}") from error
    if len(data) > largest:
        raise DataError(f"{path} is larger than {largest >> 20} MiB; {remedy}")
    return data
