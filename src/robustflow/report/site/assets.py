"""The style and scripts of the pages, and the policy that lets nothing else run."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from markupsafe import Markup

from .. import slider
from ..embed import content_policy

SCRIPTS = (
    "elements.js",
    "models.js",
    "state.js",
    "board.js",
    "figures.js",
    "findings.js",
    "downloads.js",
)


@cache
def style() -> Markup:
    """The style sheet. It is our own file, so nothing in it is escaped."""
    return Markup(_text("site.css")) + slider.style()


@cache
def script() -> Markup:
    """All scripts after one another, each in a scope of its own."""
    return Markup("".join(f"(() => {{\n{text}}})();\n" for text in (*map(_text, SCRIPTS), slider.script())))


@cache
def policy() -> str:
    """A Content-Security-Policy that allows this script by its hash, styles, and pictures inside the file."""
    return content_policy(script())


def _text(name: str) -> str:
    return (files("robustflow.report.site") / "assets" / name).read_text(encoding="utf-8")
