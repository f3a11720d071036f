"""What is embedded in a page that anyone may open: data as JSON, and the policy that lets nothing else run."""

from __future__ import annotations

import base64
import hashlib
import json
from typing import Any

from markupsafe import Markup


def json_block(value: Any) -> Markup:
    """JSON that is safe inside `<script type="application/json">`: no text in it can end the element.

    >>> print(json_block({"model": "</script><!--"}))
    {"model":"\\u003c/script\\u003e\\u003c!--"}
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def content_policy(script: str) -> str:
    """A Content-Security-Policy that allows this script by its hash, styles, and pictures inside the file."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; base-uri 'none'; "
        "form-action 'none'"
    )
