"""The gallery as one HTML file with a slider: opens from disk, loads nothing from the network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

from jinja2 import Environment

from ...errors import UsageError
from ...sample import Frame
from ..embed import content_policy, templates
from ..slider import Slider, make_slider, script, slider_markup, style
from .clip import ClipCell
from .pictures import CorruptedPicture

WIDEST = 480
"""Width in pixels to which a picture is shrunk, so that a hundred of them take a few megabytes."""

WIDEST_OF_CLIP = 288
"""The width for a clip, whose page holds a thousand pictures."""

_QUALITY, _QUALITY_OF_CLIP = 80, 50
ABSENT = "not on this scale"


def render_page(clean: Frame, cells: Sequence[CorruptedPicture], severity: int, title: str) -> str:
    """The page of a pair.

    Args:
        clean: RGB uint8 (H, W, 3), the first frame.
        cells: for every severity that the slider should reach.
        severity: where the slider starts.
        title: text; names and titles are escaped.

    Raises:
        UsageError: no cells, or none at `severity`.
    """
    severities = sorted({cell.severity for cell in cells})
    if severity not in severities:
        raise UsageError(f"there is nothing to show at severity {severity}: give cells of that severity")
    pictures = (
        (cell.name, cell.severity, [] if cell.frame is None else [cell.frame], _caption(cell)) for cell in cells
    )
    return page_of(
        make_slider(
            title,
            [clean],
            pictures,
            widest=WIDEST,
            quality=_QUALITY,
            severities=severities,
            start=severity,
            together=True,
            absent=ABSENT,
        )
    )


def clip_slider(
    clean: Sequence[Frame],
    cells: Iterable[ClipCell],
    severities: Sequence[int],
    severity: int,
    title: str,
    first_frame: int,
) -> Slider:
    """The slider of a clip's page; `cells` may be a generator, of which one cell is held at a time.

    Args:
        clean: RGB uint8 (H, W, 3), the frames shown.
        cells: the corrupted frames.
        severities: those that the slider reaches; severity: the initial one.
        title: text.
        first_frame: the number of the first of the frames in the clip.
    """
    pictures = ((cell.name, cell.severity, cell.frames, cell.caption) for cell in cells)
    return make_slider(
        title,
        clean,
        pictures,
        widest=WIDEST_OF_CLIP,
        quality=_QUALITY_OF_CLIP,
        severities=severities,
        start=severity,
        together=True,
        absent=ABSENT,
        first_frame=first_frame,
    )


def page_of(slider: Slider, remarks: Sequence[str] = ()) -> str:
    """The page around a slider, with sentences below its title."""
    return (
        _environment()
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


def example_slider(clean: Frame, cells: Iterable[CorruptedPicture], title: str) -> Slider:
    """A slider for a page on which it is one element of many; it shows one corruption at a time, severities that do not
    exist are left out, and its hundred pictures take about a megabyte."""
    pictures = ((cell.name, cell.severity, [cell.frame], "") for cell in cells if cell.frame is not None)
    return make_slider(title, [clean], pictures, widest=256, quality=50)


def _caption(cell: CorruptedPicture) -> str:
    if cell.caption:
        return cell.caption
    return "" if cell.frame is None else f"SSIM {cell.ssim:.2f}" + (", frame 2" * cell.index)


@cache
def _environment() -> Environment:
    return templates("robustflow.report.gallery")
