"""Make the small pictures for a run's severity slider, during the run or later from recomputed frames."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import DataError
from ..core.files import TEMPORARY, digest_of_bytes, write_bytes
from ..core.types import Frame
from ..media.images import jpeg_bytes, shrunk
from .example_cells import SLIDER_WIDTH

if TYPE_CHECKING:
    from .setup import Setup


def slider_picture(frames: tuple[Frame, ...], clean: tuple[Frame, ...]) -> bytes:
    """Return a JPEG of the first frame that a corruption changed: over_exposure changes only one of the two."""
    changed = [frame for frame, before in zip(frames, clean, strict=False) if not np.array_equal(frame, before)]
    return jpeg_bytes(shrunk((changed or frames)[0], SLIDER_WIDTH))


@contextmanager
def capture_slider_pictures(setup: Setup, folder: Path) -> Iterator[Setup]:
    """Yield a setup whose workers store the slider's pictures in a run's folder until the block ends, if the sample to
    show is already known.
    """
    if len(setup.plan.benchmark.keys) > 1:
        yield setup
        return
    with TemporaryDirectory(prefix=TEMPORARY, dir=folder, ignore_cleanup_errors=True) as pictures:
        options = replace(setup.options, pictures=Path(pictures))
        yield replace(setup, plan=replace(setup.plan, options=options))


def keep_picture(
    folder: Path, frames: tuple[Frame, ...], clean: tuple[Frame, ...], corruption: str, severity: int
) -> None:
    """Store the picture of a cell. A picture that cannot be written is generated later."""
    with suppress(DataError):
        write_bytes(_path(folder, corruption, severity), slider_picture(frames, clean), durable=False)


def stored_picture(folder: Path | None, corruption: str, severity: int) -> bytes | None:
    """Return the picture stored by `keep_picture`, or None."""
    try:
        return None if folder is None else _path(folder, corruption, severity).read_bytes()
    except OSError:
        return None


def _path(folder: Path, corruption: str, severity: int) -> Path:
    return folder / f"{digest_of_bytes(f'{corruption} {severity}'.encode(), size=16)}.jpg"
