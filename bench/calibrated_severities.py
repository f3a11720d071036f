"""Find the parameters at which all corruptions have the same mean SSIM.

The five parameters on the calibrated scale are taken from paths from barely visible to extreme. A path is a list of
segments; within a segment, every number changes linearly from start to end (integers are rounded, other numbers have
four significant digits), and between segments the parameters may jump. Usually, the corners of the path are the paper's
severities, extended below severity 1 until there is almost no effect, and above severity 5 as far as possible. The
exceptions are:

saturate            oversaturates, as in severities 3 to 5; 1 and 2 desaturate, which hardly affects SSIM on luma
spatter             water (severities 1, 2 and halfway to 3), then mud (4, 5 and beyond)
snow                severities 1 and 2, which have similar flakes; 3 to 5 are milder than 2 by SSIM
defocus_blur        also fractional radii, so that the disk grows by one ring of pixels at a time; up to radius 3, the
                    gaps between rings are filled by varying the anti-aliasing
glass_blur          one shuffle pass over 1, 2, 3, 4 pixels with increasing sigma at each, then two passes
psf_blur            the five lenses only, without intermediate steps

The mean SSIM is measured at fixed fractions of every segment, followed by ten bisection steps between the two points
that enclose a target. The parameter whose mean SSIM is closest to the target is chosen if it is within the tolerance.

SSIM is on luma (`robustflow.report.gallery.ssim`). Means are rounded to six decimals, so that the last bits of a
processor's arithmetic change no decision.

    python bench/calibrated_severities.py --output calibrated.json            all corruptions, 15 minutes
    python bench/calibrated_severities.py --data FOLDER --corruptions fog,contrast

With the defaults, the table must equal the shipped one. ROBUSTFLOW_CALIBRATION=FILE uses another table in its place.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import skimage

from robustflow.core.files import sealed, write_json
from robustflow.core.types import Frame
from robustflow.corruptions.api import stream_for
from robustflow.corruptions.corruption import Corruption
from robustflow.corruptions.registry import CORRUPTIONS
from robustflow.corruptions.scale import CalibratedCorruption, CalibrationTable, Level, shipped
from robustflow.media.images import images_in, read_image
from robustflow.report.gallery.ssim import Ssim


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
    runs = _RUNS.get(name, [])
    if name in _ENDS:
        below, above = _ENDS[name]
        kind: type[Corruption] = CORRUPTIONS.get(name)
        runs = [[below, *kind.paper_severities, above]]
    return [Segment(start, end) for corners in runs for start, end in pairwise(corners)]


_ENDS: dict[str, tuple[Any, Any]] = {
    "jpeg_compression": (100, 1),
    "pixelate": (1.0, 0.05),
    "contrast": (1.0, 0.0),
    "high_light": (0.0, 1.0),
    "low_light": (0.0, 1.0),
    "over_exposure": (0.0, 4.0),
    "under_exposure": (0.0, -6.0),
    "fog": ((0.0, 2.0), (10.0, 1.4)),
    "frost": ((1.0, 0.0), (0.0, 1.0)),
    "gaussian_noise": (0.002, 1.0),
    "shot_noise": (2000.0, 1.0),
    "impulse_noise": (0.0, 0.9),
    "gaussian_blur": (0.2, 30.0),
    "elastic_transform": (0.05, 100.0),
}
"""Extensions of the path beyond the paper's five severities: below severity 1, and above severity 5."""

_RUNS: dict[str, list[list[Any]]] = {
    "saturate": [[(1.0, 0.0), (2.0, 0.0), (5.0, 0.1), (20.0, 0.2), (20.0, 1.0)]],
    "spatter": [
        [
            (0.65, 0.3, 4.0, 0.69, 0.0, False),
            (0.65, 0.3, 4.0, 0.69, 0.6, False),
            (0.65, 0.3, 3.0, 0.68, 0.6, False),
            (0.65, 0.3, 2.5, 0.68, 0.55, False),
        ],
        [(0.65, 0.3, 1.0, 0.65, 1.5, True), (0.67, 0.4, 1.0, 0.65, 1.5, True), (0.75, 0.4, 1.0, 0.65, 1.5, True)],
    ],
    "snow": [
        [
            (-0.2, 0.3, 3.0, 0.5, 10, 4.0, 1.0),
            (0.1, 0.3, 3.0, 0.5, 10, 4.0, 0.8),
            (0.2, 0.3, 2.0, 0.5, 12, 4.0, 0.7),
        ]
    ],
    "defocus_blur": [
        [(1.0, 0.1), (1.0, 2.0)],
        [(2.0, 0.1), (2.0, 2.0)],
        [(2.24, 0.1), (3.0, 0.1), (3.0, 2.0)],
        [(3.17, 0.5), (4.0, 0.5), (6.0, 0.5), (10.0, 0.5), (30.0, 0.5)],
    ],
    "camera_motion_blur": [[(10, 0.2), (10, 3.0), (15, 5.0), (15, 12.0), (20, 15.0), (80, 60.0)]],
    "glass_blur": [
        [(0.6, 1, 1), (1.4, 1, 1)],
        [(0.9, 2, 1), (1.8, 2, 1)],
        [(1.5, 3, 1), (2.4, 3, 1)],
        [(2.0, 4, 1), (3.0, 4, 1)],
        [(1.5, 4, 2), (1.5, 8, 2)],
    ],
    "psf_blur": [[lens, lens] for lens in (0.0296, 0.0832, 0.1102, 0.1588, 0.1939)],
}
"""Paths of the other corruptions, as runs of corners; between two runs, the parameters jump."""

TARGETS = (0.92, 0.85, 0.78, 0.71, 0.64)
"""Target mean SSIM for severities 1 to 5; most corruptions can reach these values."""
TOLERANCE = 0.01
DRAWS = 4
PHOTOGRAPHS = (
    "astronaut.png",
    "chelsea.png",
    "coffee.png",
    "motorcycle_left.png",
    "motorcycle_right.png",
    "rocket.jpg",
)
"""The reference set: colour photographs of everyday scenes shipped with scikit-image."""
METHOD = (
    "mean over pictures and draws of the SSIM (luma, 11x11 Gaussian of sigma 1.5) of a corrupted frame to the clean "
    "one; of over_exposure and under_exposure the exposed frame is measured, the other is untouched"
)
_SCAN = 8
_HALVINGS = 10


def pictures_in(folder: Path | None = None) -> dict[str, Frame]:
    """Read the images in a folder, or those in the reference set, as RGB uint8 by name."""
    home = Path(skimage.__file__).parent / "data"
    files = [home / name for name in PHOTOGRAPHS] if folder is None else images_in(folder)
    return {file.name: read_image(file) for file in files}


def calibratable() -> list[str]:
    """Return the corruptions that have a path, in the paper's order."""
    return [name for name in CORRUPTIONS.names() if path(name)]


def calibrate(
    names: Sequence[str],
    pictures: Mapping[str, Frame],
    seed: int = 0,
    draws: int = DRAWS,
    targets: Sequence[float] = TARGETS,
    report: Callable[[str, CalibratedCorruption], None] = lambda name, calibrated: None,
) -> CalibrationTable:
    """Calibrate corruptions on a set of images."""
    references = {name: (picture, Ssim(picture)) for name, picture in pictures.items()}
    corruptions = {}
    for name in names:
        curve = _Curve(CORRUPTIONS.get(name), references, seed, draws)
        corruptions[name] = _levels(curve, path(name), targets)
        report(name, corruptions[name])
    return CalibrationTable(
        version=2,
        method=METHOD,
        seed=seed,
        draws=draws,
        images={name: hashlib.sha256(picture.tobytes()).hexdigest() for name, picture in pictures.items()},
        targets=tuple(targets),
        tolerance=TOLERANCE,
        corruptions=corruptions,
    )


@dataclass
class _Curve:
    """Mean SSIM of a corruption as a function of its parameter; each parameter is measured once."""

    kind: type[Corruption]
    references: Mapping[str, tuple[Frame, Ssim]]
    seed: int
    draws: int
    measured: dict[Any, float] = field(default_factory=dict)

    def __call__(self, parameter: Any) -> float:
        if parameter not in self.measured:
            corruption = self.kind(severities=(parameter,) * 5)
            values = [
                value
                for key, (picture, ssim) in self.references.items()
                for value in self._measure(corruption, key, picture, ssim)
            ]
            self.measured[parameter] = round(float(np.mean(values)), 6)
        return self.measured[parameter]

    def _measure(self, corruption: Corruption, key: str, picture: Frame, ssim: Ssim) -> list[float]:
        """Return the SSIM of each draw; deterministic corruptions are drawn once."""
        values: list[float] = []
        first: Frame | None = None
        for draw in range(self.draws):
            rng = stream_for(corruption, 1, self.seed, f"{key}/{draw}")
            state = corruption.draw(rng, 1, picture.shape[:2])
            # for exposure corruptions, only the choice of the frame is random
            index = getattr(state, "exposed", None) or 0
            frame = corruption.apply(picture, state, index)
            if first is not None and np.array_equal(frame, first):
                break
            first = frame if first is None else first
            values.append(ssim(frame))
        return values


def _levels(curve: _Curve, segments: Sequence[Segment], targets: Sequence[float]) -> CalibratedCorruption:
    for segment in segments:
        for step in range(_SCAN + 1):
            curve(segment.at(step / _SCAN))
    for target in targets:
        for segment in segments:
            for step in range(_SCAN):
                low, high = step / _SCAN, (step + 1) / _SCAN
                if curve(segment.at(low)) >= target > curve(segment.at(high)):
                    _halve(curve, segment, low, high, target)
    levels = []
    for target in targets:
        best = min(curve.measured, key=lambda parameter: abs(curve.measured[parameter] - target))
        ssim = curve.measured[best]
        levels.append(Level(parameter=best if abs(ssim - target) <= TOLERANCE else None, ssim=ssim))
    reached = curve.measured.values()
    return CalibratedCorruption(reachable=(min(reached), max(reached)), levels=tuple(levels))


def _halve(curve: _Curve, segment: Segment, low: float, high: float, target: float) -> None:
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if curve(segment.at(middle)) >= target:
            low = middle
        else:
            high = middle


def main() -> None:
    """Calibrate, print each corruption, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--data", type=Path, help="folder of images instead of the reference set")
    parser.add_argument("--corruptions", type=lambda text: text.split(","), default=calibratable())
    parser.add_argument("--seed", type=int, default=shipped().seed)
    parser.add_argument("--draws", type=int, default=DRAWS)
    given = parser.parse_args()

    def show(name: str, result: CalibratedCorruption) -> None:
        low, high = result.reachable
        levels = " ".join("    -" if level.parameter is None else f"{level.ssim:.3f}" for level in result.levels)
        same = "as shipped" if result == shipped().corruptions.get(name) else "differs from the shipped table"
        print(f"{name:20s} {levels}   reaches {low:.3f} to {high:.3f}   {same}", flush=True)

    table = calibrate(given.corruptions, pictures_in(given.data), given.seed, given.draws, report=show)
    if given.output is not None:
        write_json(given.output, sealed(table.model_dump(mode="json")))


if __name__ == "__main__":
    main()
