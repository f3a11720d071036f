"""Check a user-defined corruption before using it in a benchmark."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..corruptions.api import load_corruption, stream_for
from ..corruptions.base import Corruption
from ..sample import Camera, Frame, SceneDepth
from ..severity import SEVERITIES
from .contract import frames_of, require
from .displacement import displacement, distortion

_SHAPES = ((48, 64), (33, 61))
"""An even and an odd frame size, which reveal bugs in code that halves an image."""
_WAVES, _MOST_MOVED = (128, 128), 2.0
"""Size of the frames on which displacement is measured, and largest mean displacement of a corruption that leaves the
ground truth unchanged, in pixels; for `psf_blur` it is 1.4 px, for `elastic_transform` at least 3.2 px."""


def check_corruption(corruption: Any, seed: int = 0) -> str:
    """Check a corruption at all five severities, and return its name.

    Every returned frame must be RGB uint8 of the input's shape, and the input frame must not be modified. The same draw
    must return the same bytes, even in a different order and from a second instance of the class. Frame 0 must not
    depend on whether frame 1 is requested. Black, white and textured frames of even and odd sizes must work. A
    corruption that needs depth is tested on a floor in front of a wall, with known and unknown camera motion, and only
    on frames 0 and 1. Unless its `truth` is "none", a corruption must not move content by more than 2 px, apart from a
    shift of both frames by the same vector; this is measured with waves whose phase codes the position.

    Args:
        corruption: the corruption, as a class, an instance or a name; see docs/add-your-corruption.md.
        seed: the seed for the random draws.

    Raises:
        UsageError: a check failed; the message states the problem, the severity and the frame size.

    >>> import numpy as np
    >>> class Dim:
    ...     severities = (0.9, 0.8, 0.7, 0.6, 0.5)
    ...     def draw(self, rng, severity, shape):
    ...         return self.severities[severity - 1]
    ...     def apply(self, frame, state, index):
    ...         return np.rint(frame * state).astype(np.uint8)
    >>> check_corruption(Dim)
    'dim'
    """
    first, second = load_corruption(corruption), load_corruption(corruption)
    for shape in _SHAPES:
        for severity in SEVERITIES:
            if first.severities[severity - 1] is None:
                continue
            where = f"corruption '{first.name}' at severity {severity} on {shape[0]}x{shape[1]} pixels"
            frames = frames_of(shape)
            before = [frame.copy() for frame in frames]
            scene = _scene(shape, severity % 2 == 0) if first.needs_depth else None
            numbers = [place % 2 if first.needs_depth else place for place in range(len(frames))]
            state = first.draw_with_depth(stream_for(first, severity, seed, "check"), severity, shape, scene)
            forth = [first.apply(frame, state, number) for frame, number in zip(frames, numbers, strict=True)]
            for index, (frame, copy) in enumerate(zip(frames, before, strict=True)):
                require((frame == copy).all(), f"{where} modifies its input frame: copy it first")
                _check_frame(forth[index], frame, where)
            require(
                not any(np.shares_memory(a, b) for i, a in enumerate(forth) for b in forth[:i]),
                f"{where} returns the same array twice: return a new one",
            )
            again = second.draw_with_depth(stream_for(second, severity, seed, "check"), severity, shape, scene)
            pairs = zip(reversed(frames), reversed(numbers), strict=True)
            back = [second.apply(frame, again, number) for frame, number in pairs][::-1]
            for index, (one, other) in enumerate(zip(forth, back, strict=True)):
                require(
                    (one == other).all(),
                    f"{where} returns different bytes for frame {index} on the second call or in a different "
                    "order: draw all random numbers from `rng`, and numbers that differ between frames from "
                    "rng.spawn('frame', index)",
                )
    if first.truth == "unchanged":
        _check_content_stays(first, seed)
    return first.name


def _check_content_stays(corruption: Corruption, seed: int) -> None:
    scene = _scene(_WAVES, True) if corruption.needs_depth else None
    for severity in SEVERITIES:
        if corruption.severities[severity - 1] is None:
            continue
        moved = distortion(*(displacement(corruption, severity, _WAVES, index, seed, scene) for index in (0, 1)))
        require(
            moved <= _MOST_MOVED,
            f"corruption '{corruption.name}' at severity {severity} moves content by {moved:.1f} px on average, so the "
            'ground truth does not describe the corrupted frames: set truth = "none"',
        )


def _scene(shape: tuple[int, int], moves: bool) -> SceneDepth:
    """Return the depth of a floor that extends to a wall 60 m away, with unknown values in one corner; in the second
    frame, the camera is one step closer.
    """
    height, width = shape
    rows = np.arange(height, 0, -1, dtype=np.float32)[:, None]
    first = np.minimum(np.float32(2) * height / (height + 1 - rows), np.float32(60)).repeat(width, axis=1)
    known = np.ones(shape, bool)
    known[: height // 4, : width // 4] = False
    motion = (np.eye(3), np.array([0.0, 0.0, -0.25])) if moves else (None, None)
    camera = Camera((float(width), float(width)), ((width - 1) / 2, (height - 1) / 2), *motion)
    return SceneDepth((first, first - np.float32(0.25)), (known, known), camera)


def _check_frame(out: Any, frame: Frame, where: str) -> None:
    fits = isinstance(out, np.ndarray) and out.dtype == np.uint8 and out.shape == frame.shape
    require(fits, f"{where} does not return a uint8 array of shape {frame.shape}")
    require(not np.shares_memory(out, frame), f"{where} returns its input frame: return a copy")
