"""Write files atomically: a reader sees the old file, the complete new file, or no file. Pipes and devices, such as
/dev/stdout, are written directly.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from .errors import DataError

TEMPORARY = ".partial-"
"""Prefix of a file that is still being written; readers ignore such files."""


def write_bytes(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write `data` to a hidden file in the same folder, then rename it to `path`."""
    write_with(path, lambda file: file.write(data), durable=durable)


def write_with(path: Path, write: Callable[[BinaryIO], object], *, durable: bool = True) -> None:
    """Like `write_bytes`, for data that need not be in memory all at once: `write` receives the open hidden
    file."""
    try:
        if _is_pipe_or_device(path):  # a rename would put a file in its place, even in that of /dev/null
            with open(path, "wb") as stream:
                write(stream)
        else:
            _write_and_rename(path, write, durable)
    except OSError as error:
        reason = error.strerror or str(error)
        raise DataError(f"cannot write {path}: {reason}; choose an existing folder with enough free space") from error


def _is_pipe_or_device(path: Path) -> bool:
    """Whether data written to a path goes to another program or a device; /dev/stdout links to /proc."""
    if path.is_symlink() and os.readlink(path).startswith("/proc/"):
        return True
    return path.exists() and not path.is_file() and not path.is_dir()


def _write_and_rename(path: Path, write: Callable[[BinaryIO], object], durable: bool) -> None:
    temporary = path.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-{path.name}")
    try:
        with open(temporary, "xb") as file:
            write(file)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(temporary, path)
        if durable:
            sync_folder(path.parent)
    except BaseException:
        with suppress(OSError):  # also fails on a read-only file system
            temporary.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to disk where the operating system supports it (Windows and some network drives do
    not)."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def json_bytes(value: Any) -> bytes:
    """Return a value as canonical JSON: the same bytes for the same value, without NaN or infinity."""
    return (json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def write_json(path: Path, value: Any) -> None:
    """Write a value as canonical JSON, atomically."""
    write_bytes(path, json_bytes(value))


def make_folder(path: Path) -> None:
    """Create a folder and its parents, or raise a DataError that gives the reason."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        sync_folder(path.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        raise DataError(f"cannot create the folder {path}: {reason}; choose another location") from error
