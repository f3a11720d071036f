"""The gallery as one self-contained HTML file with a slider."""

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
"""Maximum picture width in pixels; the hundred pictures of a page take a few megabytes."""

WIDEST_OF_CLIP = 288
"""Maximum picture width in pixels for a clip, whose page contains about a thousand pictures."""

_QUALITY, _QUALITY_OF_CLIP = 80, 50
ABSENT = "not on this scale"


def render_page(clean: Frame, cells: Sequence[CorruptedPicture], severity: int, title: str) -> str:
    """Return the page of a pair.

    Args:
        clean: first frame, RGB uint8 (H, W, 3).
        cells: cells for every severity of the slider.
        severity: initial severity, 1 to 5.
        title: title of the page; names and titles are escaped.

    Raises:
        UsageError: there are no cells, or none at `severity`.
    """
    severities = sorted({cell.severity for cell in cells})
    if severity not in severities:
        raise UsageError(f"there is nothing to show at severity {severity}: provide cells for it")
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
    """Make the slider for the page of a clip; `cells` may be a generator, which is consumed one cell at a time.

    Args:
        clean: shown frames, RGB uint8 (H, W, 3).
        cells: cells with the corrupted frames.
        severities, severity: severities of the slider, and the initial one, 1 to 5.
        title: title of the page.
        first_frame: number in the clip of the first shown frame.
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
    """Return a page with a slider, and with remarks below its title."""
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
    """Make a slider to be embedded in a larger page. It shows one corruption at a time and omits missing severities;
    its hundred pictures take about a megabyte."""
    pictures = ((cell.name, cell.severity, [cell.frame], "") for cell in cells if cell.frame is not None)
    return make_slider(title, [clean], pictures, widest=256, quality=50)


def _caption(cell: CorruptedPicture) -> str:
    if cell.caption:
        return cell.caption
    return "" if cell.frame is None else f"SSIM {cell.ssim:.2f}" + (", frame 2" * cell.index)


@cache
def _environment() -> Environment:
    return templates("robustflow.report.gallery")
