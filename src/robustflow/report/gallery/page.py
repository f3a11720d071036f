"""The gallery as one self-contained HTML file with a slider."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from ...sample import Frame
from ..embed import content_policy, templates
from ..slider import Slider, make_slider, script, slider_markup, style
from .pictures import GalleryCell

WIDEST = 480
"""Maximum picture width in pixels; the hundred pictures of a page take a few megabytes."""

WIDEST_OF_CLIP = 288
"""Maximum picture width in pixels for a clip, whose page contains about a thousand pictures."""


def gallery_slider(
    title: str,
    clean: Sequence[Frame],
    cells: Iterable[GalleryCell],
    severities: Sequence[int],
    severity: int,
    first_frame: int = 0,
) -> Slider:
    """Make the slider of a gallery."""
    widest, quality = (WIDEST, 80) if len(clean) == 1 else (WIDEST_OF_CLIP, 50)
    return make_slider(
        title,
        clean,
        _pictures(cells),
        widest=widest,
        quality=quality,
        severities=severities,
        start=severity,
        together=True,
        absent="not on this scale",
        first_frame=first_frame,
    )


def example_slider(clean: Frame, cells: Iterable[GalleryCell], title: str) -> Slider:
    """Make a slider to be embedded in a larger page. It shows one corruption at a time; its hundred pictures take about
    a megabyte."""
    return make_slider(title, [clean], _pictures(cells), widest=256, quality=50)


def _pictures(cells: Iterable[GalleryCell]) -> Iterator[tuple[str, int, Sequence[Frame], str]]:
    return ((cell.name, cell.severity, cell.frames, cell.caption) for cell in cells)


def page_of(slider: Slider, remarks: Sequence[str] = ()) -> str:
    """Return a page with a slider, and with remarks below its title."""
    return (
        templates("robustflow.report.gallery")
        .get_template("gallery.html")
        .render(
            title=slider.title,
            remarks=remarks,
            slider=slider_markup(slider),
            style=style(),
            script=script(),
            policy=content_policy(script()),
        )
    )
