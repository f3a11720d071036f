"""The files of the repository's root that belong on the site: changelog, contributing, security."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
_PAGES = {"CHANGELOG.md": "changelog", "CONTRIBUTING.md": "contributing", "SECURITY.md": "security"}


def files() -> dict[str, str]:
    """The pages of these files, with links changed to the targets' locations on the site."""
    return {f"project/{page}.md": _moved((ROOT / name).read_text(encoding="utf-8")) for name, page in _PAGES.items()}


def _moved(text: str) -> str:
    for name, page in _PAGES.items():
        text = text.replace(f"]({name})", f"]({page}.md)")
    return re.sub(r"\]\(docs/", "](../", text)
