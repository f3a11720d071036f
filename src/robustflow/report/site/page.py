"""A page as HTML. Everything that comes from a file is escaped by the templates."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from jinja2 import Environment

from ...text import plain
from ...version import VERSION
from ..embed import json_block, templates
from ..slider import Slider, slider_markup
from . import assets
from .board import boards_of
from .content import Content
from .data import page_data
from .examples import Examples, examples_of
from .figures import PageFigure, page_figures
from .findings import VERDICT_CLASSES, audits, by_check, checked_observations
from .headline import headline
from .models import model_pages


def render_site(
    content: Content, gallery: Slider | None = None, figures: Callable[[], list[PageFigure]] | None = None
) -> str:
    """The page as one HTML file: it opens from disk and loads nothing from the network.

    Args:
        content: what it shows.
        gallery: pictures for a page whose runs have none.
        figures: gives `page_figures` of the content, if they are being drawn elsewhere.

    >>> from .content import whole_content
    >>> render_site(whole_content([])).splitlines()[0]
    '<!doctype html>'
    """
    examples = examples_of(content.runs) or (gallery and Examples(gallery))
    boards = boards_of(content.entries, dict(content.group_titles), most_models_first=not content.alone)
    pages = model_pages(content, examples.panels if examples else {})
    return (
        _environment()
        .get_template("page.html")
        .render(
            content=content,
            boards=boards,
            headline=headline(content),
            primary=pages[0].id if content.of_one_run else "",
            figures=figures() if figures else page_figures(content),
            examples=examples,
            slider=slider_markup(examples.slider) if examples else None,
            observations=checked_observations(content),
            audits=audits(content),
            data=json_block(page_data(boards, pages)),
            style=assets.style(),
            script=assets.script(),
            policy=assets.policy(),
            version=VERSION,
        )
    )


@cache
def _environment() -> Environment:
    environment = templates("robustflow.report.site")
    environment.globals.update(
        by_check=by_check,
        plain=plain,
        verdict_classes=VERDICT_CLASSES,
    )
    return environment
