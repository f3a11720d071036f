"""Hooks that mkdocs calls while it builds the site: generated pages, formulas as MathML, and two checks.

Everything that `src/` already documents is generated rather than written twice: a page for each corruption, for each
command, for rows, summaries and records. The checks are warnings, which `mkdocs build --strict` turns into errors:
every public Python name is in the reference, and no page loads anything from a different machine.
"""

from __future__ import annotations

import html
import posixpath
import re
import sys
import zlib
from logging import getLogger
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PATHS = [str(Path(__file__).parent), str(ROOT / "src")]
sys.path[:0] = PATHS

from generated import catalogue, commands, corruptions, formats, notebooks, project  # noqa: E402
from latex2mathml.converter import convert  # noqa: E402
from mkdocs.structure.files import File, Files  # noqa: E402

log = getLogger("mkdocs.hooks.site")

SHOWN_ON = {
    "src/robustflow/metrics/rows.py": "reference/rows.md",
    "src/robustflow/run/summary.py": "reference/summary.md",
    "src/robustflow/run/manifest.py": "reference/manifest.md",
    "src/robustflow/run/records/format.py": "reference/record.md",
    "src/robustflow/models/catalog": "reference/catalogue.md",
    "src/robustflow/corruptions": "corruptions/index.md",
    "src/robustflow/cli": "reference/cli/index.md",
    "docs/notebooks/own-model.ipynb": "tutorials/own-model.md",
    "docs/notebooks/reading-a-run.ipynb": "tutorials/reading-a-run.md",
}
"""The generated page for each committed file that pages link to, so that no link is dead in the repository."""

_PARTS = (corruptions, commands, formats, catalogue, notebooks, project)
_LINK = re.compile(r"\]\(([^)#:\s]+)\)")
_FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\(|\\\[)(.*?)(?:\\\)|\\\])</\1>', re.DOTALL)
_FROM_ELSEWHERE = re.compile(
    r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=\"?(?:https?:)?//[^\s>]*", re.IGNORECASE
)


def on_config(config: Any) -> Any:
    """Insert the generated folders into the navigation."""
    # repeated, because mkdocs removes the entries once this file is loaded, and processes inherit the path
    sys.path[:0] = PATHS
    for section in config.nav:
        for title, children in section.items():
            for part in (corruptions, commands):
                if children == part.FOLDER:
                    section[title] = part.navigation()
                elif isinstance(children, list):
                    for entry in children:
                        if isinstance(entry, dict) and part.FOLDER in entry.values():
                            entry[next(iter(entry))] = part.navigation()
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages and pictures."""
    for part in _PARTS:
        for path, content in part.files().items():
            files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead links to committed files to the pages that are generated from them."""
    folder = posixpath.dirname(page.file.src_uri)

    def led(match: re.Match[str]) -> str:
        shown = SHOWN_ON.get(posixpath.normpath(posixpath.join("docs", folder, match[1])))
        return match[0] if shown is None else f"]({posixpath.relpath(shown, folder or '.')})"

    return _LINK.sub(led, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Convert formulas into MathML, which browsers render natively."""
    return _FORMULA.sub(_formula, content)


def _formula(match: re.Match[str]) -> str:
    source = html.unescape(match[2]).strip()
    if match[1] == "span":
        return convert(source)
    return f'<div class="formula" tabindex="0">{convert(source, display="block")}</div>'


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Warn about resources that a page would load from a different machine."""
    for match in _FROM_ELSEWHERE.finditer(output):
        if 'rel="canonical"' not in match[0]:
            log.warning("%s loads from another machine: %s", page.file.src_uri, match[0][:120])
    return output


def on_post_build(config: Any) -> None:
    """Warn about public names that the reference lacks."""
    missing = public_names() - inventory(Path(config.site_dir) / "objects.inv")
    if missing:
        log.warning("not in the reference: %s", ", ".join(sorted(missing)))


def public_names() -> set[str]:
    """Dotted Python names in tests/public_surface.txt, without members inherited by every exception."""
    lines = (ROOT / "tests" / "public_surface.txt").read_text(encoding="utf-8").splitlines()
    names = {line.partition("(")[0] for line in lines if "." in line.partition("(")[0].partition(" ")[0]}
    return {name for name in names if name.rpartition(".")[2] not in dir(Exception)}


def inventory(path: Path) -> set[str]:
    """The names in a Sphinx inventory, which mkdocstrings writes for everything that it documents."""
    body = path.read_bytes().split(b"\n", 4)[4]
    return {line.split(" ", 1)[0] for line in zlib.decompress(body).decode().splitlines()}
