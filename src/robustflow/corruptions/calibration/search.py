"""Find the parameters at which all corruptions have the same mean SSIM.

The mean SSIM is measured at fixed fractions of every segment of a corruption's path (paths.py), followed by ten
bisection steps between the two points that enclose a target. The parameter whose mean SSIM is closest to the target is
chosen if it is within the tolerance. SSIM and corruptions are identical on every machine, so the same seed and images
always result in the same table.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import skimage

from ...errors import DataError, UsageError
from ...images.folder import IMAGE_SUFFIXES, images_in
from ...images.io import read_image
from ...sample import Frame
from ..api import stream_for
from ..base import Corruption
from ..registry import CORRUPTIONS
from ..scale import CalibratedCorruption, CalibrationTable, Level
from .paths import Segment, path
from .ssim import Ssim

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


def reference_pictures(folder: Path | None = None) -> dict[str, Frame]:
    """Read the images in a folder, or those in the reference set, as RGB uint8 by name."""
    if folder is None:
        home = Path(skimage.__file__).parent / "data"
        return {name: read_image(home / name) for name in PHOTOGRAPHS}
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; --data must be a folder with images")
    files = images_in(folder)
    if not files:
        raise DataError(
            f"{folder}: contains no images ({', '.join(IMAGE_SUFFIXES)}); --data must be a folder with images"
        )
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
    if draws < 1:
        raise UsageError(f"{draws} is not a valid number of draws: it must be at least 1")
    if not pictures:
        raise UsageError("there are no images to calibrate on: pass at least one")
    references = {name: (picture, Ssim(picture)) for name, picture in pictures.items()}
    corruptions = {}
    for name in names:
        segments = path(name)
        if not segments:
            CORRUPTIONS.get(name)
            raise UsageError(f"{name} has no path and cannot be calibrated; remove it from --corruptions")
        curve = _Curve(CORRUPTIONS.get(name), references, seed, draws)
        corruptions[name] = _levels(curve, segments, targets)
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
