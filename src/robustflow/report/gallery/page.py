"""The gallery as one HTML file with a slider: opens from disk, asks the network for nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, select_autoescape

from ...errors import UsageError
from ...images.io import jpeg_address, shrunk
from ...sample import Frame
from .pictures import Cell

WIDEST = 480
"""Pixels a picture is shrunk to, so that a hundred of them stay a few megabytes."""


@dataclass(frozen=True)
class Picture:
    """A cell as the page shows it; `uri` is empty where the severity does not exist on the scale."""

    severity: int
    caption: str
    uri: str


def render_page(clean: Frame, cells: Sequence[Cell], severity: int, title: str) -> str:
    """The page.

    Args:
        clean: RGB uint8 (H, W, 3), the first frame.
        cells: of every severity the slider shall reach.
        severity: where the slider starts.
        title: text; names and titles are escaped.

    Raises:
        UsageError: no cells, or none at `severity`.
    """
    severities = sorted({cell.severity for cell in cells})
    if severity not in severities:
        raise UsageError(f"there is nothing to show at severity {severity}: give cells of that severity")
    figures: dict[str, list[Picture]] = {}
    for cell in cells:
        uri = "" if cell.frame is None else jpeg_address(cell.frame, WIDEST)
        text = "not on this scale" if cell.frame is None else f"SSIM {cell.ssim:.2f}" + (", frame 2" * cell.index)
        figures.setdefault(cell.name, []).append(Picture(cell.severity, text, uri))
    environment = Environment(
        loader=PackageLoader("robustflow.report"),
        autoescape=select_autoescape(default=True),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    height, width = shrunk(clean, WIDEST).shape[:2]
    return environment.get_template("gallery.html").render(
        title=title,
        clean=jpeg_address(clean, WIDEST),
        figures=figures,
        severities=severities,
        severity=severity,
        width=width,
        height=height,
    )
