"""Pictures for a slider: frames as `data:` URLs, small enough that one page can contain hundreds of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ...analysis.labels import long_label
from ...images.io import jpeg_address, shrunk
from ...sample import Frame
from ...severity import SEVERITIES
from ...text import plain


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
    severities: Sequence[int] = SEVERITIES,
    start: int = 3,
    together: bool = False,
    absent: str = "This severity was not run.",
    first_frame: int = 0,
) -> Slider:
    """Make a slider from frames; `pictures` may be a generator, which is consumed one corrupted clip at a time.

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
        tuple(severities),
        start,
        together,
        absent,
        first_frame,
    )
