"""The style and scripts of the pages, and the policy that lets nothing else run."""

from __future__ import annotations

from functools import cache

from markupsafe import Markup

from .. import slider
from ..embed import asset, content_policy

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
    return Markup(asset("robustflow.report.site", "site.css")) + slider.style()


@cache
def script() -> Markup:
    """All scripts after one another, each in its own scope."""
    own = (asset("robustflow.report.site", name) for name in SCRIPTS)
    return Markup("".join(f"(() => {{\n{text}}})();\n" for text in (*own, slider.script())))


@cache
def policy() -> str:
    """A Content-Security-Policy that allows this script by its hash, styles, and pictures inside the file."""
    return content_policy(script())
