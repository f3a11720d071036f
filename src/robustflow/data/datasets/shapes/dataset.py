"""`shapes`: textured layers that move over a moving background, generated from a seed, similar to FlyingChairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....core.arguments import choice, parse_size
from ....core.errors import UsageError
from ....core.rng import Rng
from ....core.types import Camera, Sample, SceneDepth
from ..dataset import DatasetFacts
from ..pair_files import Samples
from .render import depths_of, render_pair
from .scene import Scene, draw_scene
from .textures import picture_textures, procedural_textures, texture_files

SPLITS = ("test", "train")
_SMALLEST, _LARGEST = 16, 4096
_MOST_PAIRS = 10_000_000


class FlyingShapes(Samples):
    """Generated pairs with exact flow and occlusion. All options except `pairs` determine the content of each pair."""

    name = "shapes"
    has_flow = True
    facts = DatasetFacts(
        title="Flying shapes",
        description="Textured layers that move over a moving background, generated from a seed with exact flow; as "
        "many pairs as you want.",
        licence="made by this package; no terms",
        depth="exact",
        citation="after Dosovitskiy et al., FlowNet: Learning Optical Flow with Convolutional Networks, ICCV 2015",
        layout="no root needed",
        training_set="shapes",
    )

    def __init__(
        self,
        pairs: int = 200,
        size: str = "384x512",
        seed: int = 0,
        split: str = "test",
        motion: float = 1.0,
        textures: str | None = None,
        readout: float = 0.0,
    ) -> None:
        if type(pairs) is not int or not 1 <= pairs <= _MOST_PAIRS:
            raise UsageError("pairs", f"must be an integer from 1 to {_MOST_PAIRS}, not {pairs!r}")
        if type(seed) is not int:
            raise UsageError("seed", f"must be an integer, not {seed!r}")
        choice("split", split, SPLITS)
        for option, value, most in (("motion", motion, 10), ("readout", readout, 1)):
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= most:
                raise UsageError(option, f"must be a number from 0 to {most}, not {value!r}")
        self._pairs, self._seed, self._split, self._motion = pairs, seed, split, float(motion)
        self._readout = float(readout)
        self.leaves_out_evaluated = split == "train"
        self._shape = parse_size(size, smallest=_SMALLEST, largest=_LARGEST)
        self._textures = None if textures is None else str(textures)
        if self._textures is not None:
            texture_files(self._textures)

    def keys(self) -> list[str]:
        return [f"{index:06d}" for index in range(self._pairs)]

    def files(self, key: str) -> list[Path]:
        self._checked(key)
        return [] if self._textures is None else texture_files(self._textures)

    def load(self, key: str) -> Sample:
        frames, flow, occluded = render_pair(self._scene(key), self._readout)
        return Sample(key, frames, flow, np.ones_like(occluded), occluded)

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. The depth is exact, and the focal length is the frame width. The layers move
        independently, each in a plane of constant depth, so that no camera motion explains the flow; the camera motion
        is unknown."""
        first, second = depths_of(self._scene(sample.key), self._readout)
        height, width = self._shape
        known = np.ones(self._shape, bool)
        camera = Camera((float(width),) * 2, ((width - 1) / 2, (height - 1) / 2))
        return SceneDepth((first, second), (known, known), camera)

    def depth_files(self, key: str) -> list[Path]:
        """See `Depths.depth_files`: always empty."""
        return []

    def _scene(self, key: str) -> Scene:
        index = self._checked(key)
        if self._textures is None:
            textures = procedural_textures(self._seed, self._split)
        else:
            textures = picture_textures(self._textures)
        return draw_scene(Rng.of(self._seed, "shapes", self._split, "pair", index), self._shape, self._motion, textures)

    def _checked(self, key: str) -> int:
        if len(key) >= 6 and key.isdecimal() and key == f"{int(key):06d}" and int(key) < self._pairs:
            return int(key)
        raise UsageError(key, f"no such sample of shapes; its keys are '000000' to '{self._pairs - 1:06d}'")
