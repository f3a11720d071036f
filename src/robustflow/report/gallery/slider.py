"""A slider over severities, with its pictures as small `data:` URLs, its HTML, style and script for any page; and the
files of a gallery."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

from markupsafe import Markup

from ...core.text import plain
from ...core.types import Frame
from ...media.images import jpeg_address, shrunk
from ...stats.results import long_label
from ..notebook import asset, content_policy, json_block, templates
from .cells import GalleryCell
from .draw import draw_gallery

_PACKAGE = "robustflow.report.gallery"

WIDEST = 480
"""Maximum picture width in pixels; the hundred pictures of a page take a few megabytes."""

WIDEST_OF_CLIP = 288
"""Maximum picture width in pixels for a clip, whose page contains about a thousand pictures."""


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
    start: int = 3
    together: bool = False
    absent: str = "This severity was not run."
    first_frame: int = 0


def make_slider(
    title: str, clean: Sequence[Frame], cells: Iterable[GalleryCell], *, widest: int, quality: int, **shown: Any
) -> Slider:
    """Make a slider from frames; `cells` may be a generator, which is consumed one corrupted clip at a time. `shown`
    are the other fields of the slider.

    >>> import numpy as np
    >>> grey = np.full((32, 48, 3), 128, np.uint8)
    >>> cells = [GalleryCell("fog", severity, [grey]) for severity in (2, 1)]
    >>> slider = make_slider("grey", [grey], cells, widest=24, quality=60)
    >>> slider.width, slider.height, [(name, [s.severity for s in shots]) for name, shots in slider.corruptions]
    (24, 16, [('Fog', [1, 2])])
    """

    def addresses(frames: Iterable[Frame]) -> tuple[str, ...]:
        return tuple(jpeg_address(frame, widest, quality) for frame in frames)

    by_name: dict[str, list[Shot]] = {}
    for cell in cells:
        shots = by_name.setdefault(cell.name, [])
        if cell.frames:
            shots.append(Shot(cell.severity, addresses(cell.frames), cell.caption))
    height, width = shrunk(clean[0], widest).shape[:2]
    corruptions = tuple(
        (plain(long_label(name)), tuple(sorted(shots, key=lambda shot: shot.severity)))
        for name, shots in by_name.items()
    )
    return Slider(title, width, height, addresses(clean), corruptions, **shown)


def slider_markup(slider: Slider) -> Markup:
    """Return the slider's HTML element, which contains its pictures as data. All text is escaped."""
    template = templates(_PACKAGE).get_template("slider.html")
    return Markup(template.render(slider=slider, data=json_block(asdict(slider))))


@cache
def style() -> Markup:
    """Return the slider's style sheet, which uses the page's colour variables if they are defined."""
    return Markup(asset(_PACKAGE, "slider.css"))


@cache
def script() -> Markup:
    """Return the slider's script, to be included once, below all sliders of a page."""
    return Markup(asset(_PACKAGE, "slider.js"))


def gallery_files(
    title: str,
    clean: Sequence[Frame],
    cells: Iterable[GalleryCell],
    severity: int,
    first_frame: int = 0,
    remarks: Sequence[str] = (),
) -> dict[str, bytes]:
    """Return the files of a gallery by name: a figure of one severity (PNG and PDF), and a page with a slider over all
    severities, with remarks below its title. Of `cells`, only the pictures of that severity are kept in memory."""
    shown: list[GalleryCell] = []

    def passed() -> Iterator[GalleryCell]:
        for cell in cells:
            if cell.severity == severity:
                shown.append(cell)
            yield cell

    widest, quality = (WIDEST, 80) if len(clean) == 1 else (WIDEST_OF_CLIP, 50)
    how = {"start": severity, "together": True, "absent": "not on this scale", "first_frame": first_frame}
    slider = make_slider(title, clean, passed(), widest=widest, quality=quality, **how)
    template = templates(_PACKAGE).get_template("gallery.html")
    page = template.render(
        title=title,
        remarks=remarks,
        slider=slider_markup(slider),
        style=style(),
        script=script(),
        policy=content_policy(script()),
    )
    pictures = {
        f"gallery.{form}": draw_gallery(clean[0], shown, f"{title}, severity {severity}", form)
        for form in ("png", "pdf")
    }
    return pictures | {"gallery.html": page.encode()}
