"""HTML of the slider, with its style and script, for inclusion in any page."""

from __future__ import annotations

from functools import cache
from typing import Any

from markupsafe import Markup

from ..embed import asset, json_block, templates
from .pictures import Shot, Slider


def slider_markup(slider: Slider) -> Markup:
    """Return the slider's HTML element, which contains its pictures as data. All text is escaped."""
    figures = []
    for index, (name, shots) in enumerate(slider.corruptions):
        shown = _first(slider, shots)
        hidden = not slider.together and index > 0
        figures.append({"name": name, "shot": shown, "hidden": hidden})
    template = templates("robustflow.report.slider").get_template("slider.html")
    return Markup(template.render(slider=slider, figures=figures, data=json_block(_data(slider))))


@cache
def style() -> Markup:
    """Return the slider's style sheet, which uses the page's colour variables if they are defined."""
    return Markup(asset("robustflow.report.slider", "slider.css"))


@cache
def script() -> Markup:
    """Return the slider's script, to be included once, below all sliders of a page."""
    return Markup(asset("robustflow.report.slider", "slider.js"))


def _first(slider: Slider, shots: tuple[Shot, ...]) -> Shot | None:
    if slider.together:
        return next((shot for shot in shots if shot.severity == slider.start), None)
    return min(shots, key=lambda shot: abs(shot.severity - slider.start), default=None)


def _data(slider: Slider) -> dict[str, Any]:
    """Return the data for the script. Pictures that are already part of the markup are null, so that no picture is
    embedded twice."""
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
