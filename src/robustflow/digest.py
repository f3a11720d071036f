"""Hashes that identify content: bytes, files, and any value that JSON can represent."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from blake3 import blake3


def digest_of_bytes(*parts: bytes | memoryview, size: int = 16) -> str:
    """Return the BLAKE2b hash of the concatenated parts as 2 x `size` hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=size)
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def quick_digest_of_bytes(*parts: bytes | memoryview, size: int = 16) -> str:
    """Return the BLAKE3 hash of the concatenated parts. For large data: a KITTI pair takes 0.8 ms instead of 4.5 ms
    with BLAKE2b.

    >>> quick_digest_of_bytes(b"ab", b"c") == quick_digest_of_bytes(b"abc")
    True
    """
    digest = blake3()
    for part in parts:
        digest.update(part)
    return digest.hexdigest(length=size)


def quick_digest_of_file(path: Path) -> str:
    """Return the BLAKE3 hash of a file of any size."""
    digest = blake3()
    digest.update_mmap(path)
    return digest.hexdigest(length=16)


def sha256_of_file(path: Path) -> str:
    """Return the SHA-256 of a file of any size as hexadecimal digits, the usual form of published checksums."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_of_value(value: Any, size: int = 8) -> str:
    """Return the hash of a value's canonical JSON: sorted keys, no spaces, and `str()` of values that JSON does not
    support.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return digest_of_bytes(text.encode(), size=size)
