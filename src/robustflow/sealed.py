"""Store content with its digest, so that damage is detected on reading."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from .digest import digest_of_bytes, digest_of_value

_DIGEST = "digest"
_DIGEST_BYTES = 16


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return JSON content with its digest added; an existing digest is replaced."""
    body = {name: value for name, value in content.items() if name != _DIGEST}
    return {**body, _DIGEST: digest_of_value(body, size=_DIGEST_BYTES)}


def unsealed(data: bytes) -> bytes | None:
    """Return the JSON text of an object without its digest, or None if the digest does not match."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or content != sealed(content):
        return None
    return json.dumps({name: value for name, value in content.items() if name != _DIGEST}).encode()


def sealed_bytes(data: bytes, made_of: str) -> bytes:
    """Append a 16-byte digest of the bytes and of `made_of`, a description of the inputs that the bytes were computed
    from."""
    return data + _digest(data, made_of)


def unsealed_bytes(data: bytes, made_of: str) -> bytes | None:
    """Return the sealed bytes, or None if they are damaged or were computed from different inputs."""
    content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    return content if digest == _digest(content, made_of) else None


def _digest(data: bytes, made_of: str) -> bytes:
    return bytes.fromhex(digest_of_bytes(made_of.encode(), b"\0", data, size=_DIGEST_BYTES))
