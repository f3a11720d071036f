"""Compare the output of every pair corruption on this machine with stored hashes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from importlib import resources
from importlib.resources.abc import Traversable

import numpy as np

from ..core.errors import AssetError, first_line
from ..core.files import quick_digest_of_bytes
from ..core.opencv import one_opencv_thread
from ..core.rng import Rng
from ..core.types import Camera, DepthMap, Frame, SceneDepth
from .api import corrupt
from .registry import CLIP, SHIPPED

CHECKED: tuple[str, ...] = tuple(name for name in SHIPPED if name not in CLIP)
"""Corruptions with stored hashes: all except clip corruptions."""
DIGESTS = resources.files(__package__) / "data" / "digests.json"
SEVERITIES = (1, 3, 5)
_SEED = 3
_BLOCKS, _SIDE = (12, 20), 8
_SHIFT = (2, 5)


def compare_with_package() -> Iterator[tuple[str, str]]:
    """Yield each corruption with a description of how this machine's frames differ (empty if they are identical)."""
    yield from compare(CHECKED, digests_of, DIGESTS)


def compare(
    names: Iterable[str], digests_of: Callable[[str], dict[str, str]], path: Traversable
) -> Iterator[tuple[str, str]]:
    """Yield each name with a description of how `digests_of` differs from the JSON file at `path`."""
    expected = json.loads(path.read_text(encoding="utf-8"))
    for name in names:
        if name not in expected:
            yield name, "no reference bytes are stored; store them with 'python -m tests.rewrite'"
            continue
        try:
            digests = digests_of(name)
        except AssetError as error:
            yield name, f"not compared: {first_line(error)}"
            continue
        differing = [str(level) for level in SEVERITIES if digests[str(level)] != expected[name][str(level)]]
        yield name, f"different bytes at severity {', '.join(differing)}" if differing else ""


def digests_of(name: str) -> dict[str, str]:
    """Return the hash of the corrupted pair for each severity, as computed on this machine."""
    pair, depth = _pair(), _depth()
    with one_opencv_thread():
        made = {str(level): corrupt(*pair, name, level, _SEED, depth=depth) for level in SEVERITIES}
    return {level: quick_digest_of_bytes(*(frame.tobytes() for frame in frames)) for level, frames in made.items()}


def _pair() -> tuple[Frame, Frame]:
    frame = _first_frame()
    return frame, np.roll(frame, _SHIFT, axis=(0, 1))


def moving_frames(count: int) -> list[Frame]:
    """Return the frames of a clip, uint8 (96, 160, 3), whose upper and lower halves move in opposite directions."""
    upper, lower = np.vsplit(_first_frame(), 2)
    return [np.vstack([np.roll(upper, 2 * i, axis=1), np.roll(lower, -3 * i, axis=1)]) for i in range(count)]


def _first_frame() -> Frame:
    """Return a 96x160 frame of coloured, noisy blocks, computed using only integer arithmetic."""
    rng = Rng.of("machine check")
    height, width = (blocks * _SIDE for blocks in _BLOCKS)
    colours = rng.bits(_BLOCKS[0] * _BLOCKS[1] * 3) % 224
    noise = rng.bits(height * width * 3) % 32
    blocks = colours.reshape(*_BLOCKS, 3).repeat(_SIDE, axis=0).repeat(_SIDE, axis=1)
    return (blocks + noise.reshape(height, width, 3)).astype(np.uint8)


def _depth() -> SceneDepth:
    """Return depth maps of blocks at 2 to 65.75 m, seen by a camera that moves forward and to the left."""
    blocks = 2 + (Rng.of("machine check", "depth").bits(_BLOCKS[0] * _BLOCKS[1]) % 256) / 4
    first: DepthMap = blocks.astype(np.float32).reshape(_BLOCKS).repeat(_SIDE, axis=0).repeat(_SIDE, axis=1)
    second = np.roll(first, _SHIFT, axis=(0, 1))
    height, width = first.shape
    camera = Camera((160.0, 160.0), (width / 2, height / 2), np.eye(3), np.array([0.25, 0.0, -0.5]))
    measured = np.ones(first.shape, bool)
    return SceneDepth((first, second), (measured, measured), camera)
