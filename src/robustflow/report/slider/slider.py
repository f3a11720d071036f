"""A slider over severities: its pictures as small `data:` URLs, and its HTML, style and script for any page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from markupsafe import Markup

from ...core.arguments import SEVERITIES
from ...core.text import plain
from ...core.types import Frame
from ...media.images import jpeg_address, shrunk
from ...stats.results import long_label
from ..notebook import asset, json_block, templates


@dataclass(frozen=True)
class Shot:
    """A corruption at one severity: a `data:` URL for each frame, and a caption."""

    severity: int
    pictures: tuple[str, ...]
    caption: str = ""


@dataclass(frozen=True)
class Slider:
    """A slider: clean frames and their corrupted versions."""

    title: str
    width: int
    height: int
    clean: tuple[str, ...]
    corruptions: tuple[tuple[str, tuple[Shot, ...]], ...]
    severities: tuple[int, ...] = SEVERITIES
    start: int = 3
    together: bool = False
    absent: str = "This severity was not run."
    first_frame: int = 0


def make_slider(
    title: str,
    clean: Sequence[Frame],
    pictures: Iterable[tuple[str, int, Sequence[Frame], str]],
    *,
    widest: int,
    quality: int,
    **shown: Any,
) -> Slider:
    """Make a slider from frames; `pictures` may be a generator, which is consumed one corrupted clip at a time. `shown`
    are the other fields of the slider.

    >>> import numpy as np
    >>> grey = np.full((32, 48, 3), 128, np.uint8)
    >>> slider = make_slider("grey", [grey], [("fog", 2, [grey], ""), ("fog", 1, [grey], "")], widest=24, quality=60)
    >>> slider.width, slider.height, [(name, [s.severity for s in shots]) for name, shots in slider.corruptions]
    (24, 16, [('Fog', [1, 2])])
    """
    by_name: dict[str, list[Shot]] = {}
    for corruption, severity, frames, caption in pictures:
        shots = by_name.setdefault(corruption, [])
        if frames:
            shots.append(Shot(severity, tuple(jpeg_address(frame, widest, quality) for frame in frames), caption))
    height, width = shrunk(clean[0], widest).shape[:2]
    return Slider(
        title,
        width,
        height,
        tuple(jpeg_address(frame, widest, quality) for frame in clean),
        tuple(
            (plain(long_label(name)), tuple(sorted(shots, key=lambda shot: shot.severity)))
            for name, shots in by_name.items()
        ),
        **shown,
    )


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
