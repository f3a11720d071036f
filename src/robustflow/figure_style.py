"""matplotlib's own settings for every figure, whatever `matplotlibrc` the working folder or the user has."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

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
