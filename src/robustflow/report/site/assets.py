"""Style sheet and scripts of the pages, and the policy that blocks any other script."""

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
    """Return the style sheet. It ships with the package, so it is not escaped."""
    return Markup(asset("robustflow.report.site", "site.css")) + slider.style()


@cache
def script() -> Markup:
    """Concatenate all scripts, each in a separate scope."""
    own = (asset("robustflow.report.site", name) for name in SCRIPTS)
    return Markup("".join(f"(() => {{\n{text}}})();\n" for text in (*own, slider.script())))


@cache
def policy() -> str:
    """Return a Content-Security-Policy that allows inline styles, embedded pictures, and this script by its hash."""
    return content_policy(script())
