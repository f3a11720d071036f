"""Paths through the parameters of each corruption, from barely visible to extreme.

The five parameters on the calibrated scale are taken from these paths. A path is a list of segments; within a segment,
every number changes linearly from start to end (integers are rounded, other numbers have four significant digits), and
between segments the parameters may jump. Usually, the corners of the path are the paper's severities, extended below
severity 1 until there is almost no effect, and above severity 5 as far as possible. The exceptions are:

saturate            oversaturates, as in severities 3 to 5; 1 and 2 desaturate, which hardly affects SSIM on luma
spatter             water (severities 1, 2 and halfway to 3), then mud (4, 5 and beyond)
snow                severities 1 and 2, which have similar flakes; 3 to 5 are milder than 2 by SSIM
glass_blur          one shuffle pass over 1, 2, 3, 4 pixels with increasing sigma at each, then two passes
psf_blur            the five lenses only, without intermediate steps

defocus_blur also uses fractional radii, so that the disk grows by one ring of pixels at a time. Up to radius 3, the
rings are far apart, and the gaps are filled by varying the anti-aliasing.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

from ..base import Corruption
from ..registry import CORRUPTIONS


class Segment(NamedTuple):
    """The parameters at both ends of a segment; their types are the same."""

    start: Any
    end: Any

    def at(self, share: float) -> Any:
        """Return the interpolated parameter; `share` is 0 at the start and 1 at the end."""
        if isinstance(self.start, tuple):
            return tuple(_interpolated(a, b, share) for a, b in zip(self.start, self.end, strict=True))
        return _interpolated(self.start, self.end, share)


def _interpolated(start: Any, end: Any, share: float) -> Any:
    if isinstance(start, bool):
        return start
    value = start + (end - start) * share
    if isinstance(start, int) and isinstance(end, int):
        return round(value)
    return float(f"{value:.4g}")


def path(name: str) -> list[Segment]:
    """Return the path of a corruption, from mild to extreme; empty for clip corruptions and user-defined ones."""
    if name in _OWN:
        return _OWN[name]
    if name not in _ENDS:
        return []
    kind: type[Corruption] = CORRUPTIONS.get(name)
    below, above = _ENDS[name]
    corners = [below, *kind.paper_severities, *above]
    return [Segment(a, b) for a, b in pairwise(corners)]


_ENDS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "jpeg_compression": (100, (1,)),
    "pixelate": (1.0, (0.05,)),
    "contrast": (1.0, (0.0,)),
    "high_light": (0.0, (1.0,)),
    "low_light": (0.0, (1.0,)),
    "over_exposure": (0.0, (4.0,)),
    "under_exposure": (0.0, (-6.0,)),
    "fog": ((0.0, 2.0), ((10.0, 1.4),)),
    "frost": ((1.0, 0.0), ((0.0, 1.0),)),
    "gaussian_noise": (0.002, (1.0,)),
    "shot_noise": (2000.0, (1.0,)),
    "impulse_noise": (0.0, (0.9,)),
    "gaussian_blur": (0.2, (30.0,)),
    "elastic_transform": (0.05, (100.0,)),
}
"""Extensions of the path beyond the paper's five severities: (below severity 1, above severity 5)."""

_LENSES = (0.0296, 0.0832, 0.1102, 0.1588, 0.1939)

_OWN: dict[str, list[Segment]] = {
    "saturate": [
        Segment((1.0, 0.0), (2.0, 0.0)),
        Segment((2.0, 0.0), (5.0, 0.1)),
        Segment((5.0, 0.1), (20.0, 0.2)),
        Segment((20.0, 0.2), (20.0, 1.0)),
    ],
    "spatter": [
        Segment((0.65, 0.3, 4.0, 0.69, 0.0, False), (0.65, 0.3, 4.0, 0.69, 0.6, False)),
        Segment((0.65, 0.3, 4.0, 0.69, 0.6, False), (0.65, 0.3, 3.0, 0.68, 0.6, False)),
        Segment((0.65, 0.3, 3.0, 0.68, 0.6, False), (0.65, 0.3, 2.5, 0.68, 0.55, False)),
        Segment((0.65, 0.3, 1.0, 0.65, 1.5, True), (0.67, 0.4, 1.0, 0.65, 1.5, True)),
        Segment((0.67, 0.4, 1.0, 0.65, 1.5, True), (0.75, 0.4, 1.0, 0.65, 1.5, True)),
    ],
    "snow": [
        Segment((-0.2, 0.3, 3.0, 0.5, 10, 4.0, 1.0), (0.1, 0.3, 3.0, 0.5, 10, 4.0, 0.8)),
        Segment((0.1, 0.3, 3.0, 0.5, 10, 4.0, 0.8), (0.2, 0.3, 2.0, 0.5, 12, 4.0, 0.7)),
    ],
    "defocus_blur": [
        Segment((1.0, 0.1), (1.0, 2.0)),
        Segment((2.0, 0.1), (2.0, 2.0)),
        Segment((2.24, 0.1), (3.0, 0.1)),
        Segment((3.0, 0.1), (3.0, 2.0)),
        Segment((3.17, 0.5), (4.0, 0.5)),
        Segment((4.0, 0.5), (6.0, 0.5)),
        Segment((6.0, 0.5), (10.0, 0.5)),
        Segment((10.0, 0.5), (30.0, 0.5)),
    ],
    "camera_motion_blur": [
        Segment((10, 0.2), (10, 3.0)),
        Segment((10, 3.0), (15, 5.0)),
        Segment((15, 5.0), (15, 12.0)),
        Segment((15, 12.0), (20, 15.0)),
        Segment((20, 15.0), (80, 60.0)),
    ],
    "glass_blur": [
        Segment((0.6, 1, 1), (1.4, 1, 1)),
        Segment((0.9, 2, 1), (1.8, 2, 1)),
        Segment((1.5, 3, 1), (2.4, 3, 1)),
        Segment((2.0, 4, 1), (3.0, 4, 1)),
        Segment((1.5, 4, 2), (1.5, 8, 2)),
    ],
    "psf_blur": [Segment(lens, lens) for lens in _LENSES],
}
