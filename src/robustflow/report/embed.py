"""Building blocks of safe HTML pages: escaping templates, embedded JSON data, and a content security policy."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup


@cache
def templates(package: str) -> Environment:
    """Return the Jinja environment for a package's `templates` folder, with autoescaping on."""
    return Environment(loader=PackageLoader(package), autoescape=True, trim_blocks=True, lstrip_blocks=True)


def asset(package: str, name: str) -> str:
    """Return the text of a file in a package's `assets` folder."""
    return (files(package) / "assets" / name).read_text(encoding="utf-8")


def json_block(value: Any) -> Markup:
    """Serialise to JSON that is safe inside `<script type="application/json">`: no string in it can close the
    element.
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def content_policy(script: str) -> str:
    """Return a Content-Security-Policy that allows inline styles, embedded pictures, and this script by its hash."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; base-uri 'none'; "
        "form-action 'none'"
    )
