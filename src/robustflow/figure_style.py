"""matplotlib's default settings for every figure, whatever `matplotlibrc` the working folder or the user has; and
pictures in a figure."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .sample import Frame

_OF_THE_WORKING_FOLDER = "matplotlibrc"


def ignore_local_settings() -> None:
    """Import matplotlib where it cannot read the working folder's `matplotlibrc`, if there is one. It would read it on
    its first import, and fail on a file that is not text.

    Called before there are threads, which would see a different working folder for a moment.
    """
    if not os.path.lexists(_OF_THE_WORKING_FOLDER):
        return
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(os.sep)
        import matplotlib  # noqa: F401
    finally:
        os.fchdir(here)
        os.close(here)


@contextmanager
def default_style() -> Iterator[None]:
    """Within the block, or the decorated function, figures are made and saved with matplotlib's defaults.

    >>> import matplotlib
    >>> with default_style():
    ...     matplotlib.rcParams["lines.linewidth"]
    1.5
    """
    import matplotlib

    with matplotlib.rc_context(
        {name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"}
    ):
        yield


def add_picture(
    figure: Figure, left: float, top: float, width: float, height: float, picture: Frame, title: str, size: float
) -> None:
    """Add a picture under its title to a figure, without axes, whose ticks take longer than the picture.

    Args:
        figure: whose size is final.
        left, top: upper left corner of the picture, inches from that of the figure.
        width, height: of the picture, inches; it is stretched to them.
        picture: RGB uint8 (H, W, 3).
        title: above the picture, from its left edge.
        size: of the title, points.
    """
    from matplotlib.image import BboxImage
    from matplotlib.transforms import Bbox, TransformedBbox

    below = figure.get_figheight() - top - height
    place = TransformedBbox(Bbox.from_bounds(left, below, width, height), figure.dpi_scale_trans)
    figure.add_artist(BboxImage(place, interpolation="antialiased", data=picture))
    above = below + height + 0.3 * size / 72
    figure.text(left, above, title, fontsize=size, transform=figure.dpi_scale_trans)
