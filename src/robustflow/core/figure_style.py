"""Draw every figure with matplotlib's default settings, regardless of any `matplotlibrc`; add pictures to figures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .types import Frame

_OF_THE_WORKING_FOLDER = "matplotlibrc"


def ignore_local_settings() -> None:
    """Import matplotlib without reading the working folder's `matplotlibrc`. matplotlib reads this file on first
    import, and fails if it is not a text file.
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
    """Use matplotlib's defaults for figures made and saved within the block or the decorated function.

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
    """Add a picture with a title above it to a figure, without axes, because drawing ticks takes longer than drawing
    the picture.
    """
    from matplotlib.image import BboxImage
    from matplotlib.transforms import Bbox, TransformedBbox

    below = figure.get_figheight() - top - height
    place = TransformedBbox(Bbox.from_bounds(left, below, width, height), figure.dpi_scale_trans)
    figure.add_artist(BboxImage(place, interpolation="antialiased", data=picture))
    above = below + height + 0.3 * size / 72
    figure.text(left, above, title, fontsize=size, transform=figure.dpi_scale_trans, parse_math=False)
