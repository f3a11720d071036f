"""The slider as HTML, with its style and script, for inclusion in any page."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

from ..embed import asset, json_block, templates
from .pictures import Shot, Slider


def slider_markup(slider: Slider) -> Markup:
    """The slider's element, with its pictures as data. Every text in it is escaped.

    The pictures shown initially are in the markup itself, so that they are visible without scripts.
    """
    figures = []
    for index, (name, shots) in enumerate(slider.corruptions):
        shown = _first(slider, shots)
        hidden = not slider.together and index > 0
        figures.append({"name": name, "shot": shown, "hidden": hidden})
    template = _environment().get_template("slider.html")
    return Markup(template.render(slider=slider, figures=figures, data=json_block(_data(slider))))


@cache
def style() -> Markup:
    """The slider's style sheet; colours are taken from the page's own variables if it has them."""
    return Markup(asset("robustflow.report.slider", "slider.css"))


@cache
def script() -> Markup:
    """The slider's script, to be run once, below all sliders of a page."""
    return Markup(asset("robustflow.report.slider", "slider.js"))


def _first(slider: Slider, shots: tuple[Shot, ...]) -> Shot | None:
    if slider.together:
        return next((shot for shot in shots if shot.severity == slider.start), None)
    return min(shots, key=lambda shot: abs(shot.severity - slider.start), default=None)


def _data(slider: Slider) -> dict[str, Any]:
    """The data for the script. Pictures in the markup are null here, so that their bytes are in the page only once."""
    corruptions = []
    for name, shots in slider.corruptions:
        first = _first(slider, shots)
        of_severity = {
            shot.severity: {"pictures": (None, *shot.pictures[1:]) if shot is first else shot.pictures,
                            "caption": shot.caption}
            for shot in shots
        }  # fmt: skip
        corruptions.append({"name": name, "first": first.severity if first else None, "shots": of_severity})
    return {"clean": (None, *slider.clean[1:]), "corruptions": corruptions, "firstFrame": slider.first_frame}


@cache
def _environment() -> Environment:
    return templates("robustflow.report.slider")
