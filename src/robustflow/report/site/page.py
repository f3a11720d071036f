"""A page as HTML. Everything that comes from a file is escaped by the templates."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from ...text import plain
from ...version import VERSION
from . import assets
from .board import boards_of
from .content import Content
from .data import page_data
from .examples import Examples, Slider, examples_of
from .figures import page_figures
from .findings import VERDICT_CLASSES, audits, by_check, checked_observations
from .headline import headline
from .models import model_pages


def render_site(content: Content, gallery: Slider | None = None) -> str:
    """The page as one HTML file: it opens from disk and asks the network for nothing.

    Args:
        content: what it shows.
        gallery: pictures for a page whose runs have none.

    >>> from .content import whole_content
    >>> render_site(whole_content([])).splitlines()[0]
    '<!doctype html>'
    """
    examples = examples_of(content.runs) or (gallery and Examples(gallery))
    boards = boards_of(content.entries, dict(content.group_titles))
    pages = model_pages(content, examples.panels if examples else {})
    return (
        _environment()
        .get_template("page.html")
        .render(
            content=content,
            boards=boards,
            headline=headline(content),
            primary=pages[0].id if content.of_one_run else "",
            figures=page_figures(content),
            examples=examples,
            observations=checked_observations(content),
            audits=audits(content),
            data=json_block(page_data(boards, pages)),
            style=assets.style(),
            script=assets.script(),
            policy=assets.policy(),
            version=VERSION,
        )
    )


def json_block(value: Any) -> Markup:
    """JSON that may stand inside `<script type="application/json">`: no text in it can end the element.

    >>> print(json_block({"model": "</script><!--"}))
    {"model":"\\u003c/script\\u003e\\u003c!--"}
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("robustflow.report.site"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(
        by_check=by_check,
        plain=plain,
        verdict_classes=VERDICT_CLASSES,
    )
    return environment
