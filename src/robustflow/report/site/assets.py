"""The style and scripts of the pages, and the policy that lets nothing else run."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files

from markupsafe import Markup

SCRIPTS = (
    "elements.js",
    "models.js",
    "state.js",
    "board.js",
    "figures.js",
    "findings.js",
    "examples.js",
    "downloads.js",
)


@cache
def style() -> Markup:
    """The style sheet. It is our own file, so nothing in it is escaped."""
    return Markup(_text("site.css"))


@cache
def script() -> Markup:
    """All scripts after one another, each in a scope of its own."""
    return Markup("".join(f"(() => {{\n{_text(name)}}})();\n" for name in SCRIPTS))


@cache
def policy() -> str:
    """A Content-Security-Policy that allows this script by its hash, styles, and pictures inside the file."""
    digest = base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; base-uri 'none'; "
        "form-action 'none'"
    )


def _text(name: str) -> str:
    return (files("robustflow.report.site") / "assets" / name).read_text(encoding="utf-8")
