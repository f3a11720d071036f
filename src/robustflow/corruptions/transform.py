"""Apply random corruptions with random severities to training images.

Every random draw has a name. With a `key`, the result depends only on the seed, the key and the images. Without a key,
the name consists of the number of the call and an identifier of the process: in a torch `DataLoader` worker, this is
the seed that torch assigned to the worker (different in every epoch, fixed by `torch.manual_seed`); in other child
processes, it is the name of the process; torchrun's rank is added. So samples from a data loader never share a draw by
accident, regardless of the number of workers and ranks. Pass a key such as f"{epoch}/{index}" if the bytes must not
depend on the number of workers, or if several copies of a transform are used in one process (e.g. by a pool that
pickles the transform with every task), because all copies continue counting from the same number.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..core.arguments import SEVERITIES, check_severity
from ..core.errors import DataError, UsageError
from ..core.rng import Rng, check_seed
from ..core.types import Frame
from .api import load_corruption
from .condition import condition_of
from .corruption import Corruption
from .registry import CLIP, IMAGE_PAIR

Image = npt.NDArray[Any]
"""An image, uint8 or float32 in [0, 1]; RGB (H, W, 3) or grey (H, W) or (H, W, 1)."""

DEFAULT_NAMES: tuple[str, ...] = tuple(name for name in IMAGE_PAIR if name != "psf_blur")
"""Default corruptions: all but psf_blur, which takes 0.05 to 0.2 s per pair of KITTI frames; the others take 16 ms
at most.
"""

_COUNTING = threading.Lock()
"""Guards the numbers of calls; shared by all transforms, which can therefore be pickled."""

_COLOURED = ("saturate", "spatter", "frost", "psf_blur")
_NEUTRAL = frozenset((*IMAGE_PAIR, "elastic_transform")) - frozenset(_COLOURED)


class CorruptionTransform:
    """Corrupts images, pairs and clips at random; callable, picklable and safe in data loader workers.

    Args:
        names: corruptions to choose from, with equal probability: names, or custom corruptions as classes or objects.
            By default, these are all image-pair corruptions except psf_blur, which takes ten times as long as the
            others; to include it, add its name. Stacks such as "fog+jpeg_compression" are allowed; corruptions of
            entire clips (h264_crf, ...) are not.
        severities: severities to choose from, 1 to 5, with equal probability.
        probability: probability of applying a corruption, 0 to 1.
        seed: seed for all random draws.
        variant, scale: variant and severity scale; see `load_corruption`. Severities that do not exist on the scale for
            a corruption are never chosen for it.

    Raises:
        UsageError: a name is unknown or unsuitable, none of the severities exist for a corruption, the probability is
            outside [0, 1], or the seed is not a whole number.

    >>> transform = CorruptionTransform(["gaussian_noise", "contrast"], severities=[1, 2], seed=3)
    >>> image = np.full((24, 32, 3), 0.5, np.float32)
    >>> out = transform(image)
    >>> out.shape, out.dtype.name, bool((transform(image, key="a") == transform(image, key="a")).all())
    ((24, 32, 3), 'float32', True)
    >>> transform
    CorruptionTransform(names=['gaussian_noise', 'contrast'], severities=[1, 2], probability=1.0, seed=3)
    """

    def __init__(
        self,
        names: Sequence[str | Corruption | type[Corruption]] | None = None,
        severities: Sequence[int] = SEVERITIES,
        probability: float = 1.0,
        seed: int = 0,
        variant: str = "default",
        scale: str = "paper",
    ) -> None:
        if not 0.0 <= probability <= 1.0:
            raise UsageError("probability", f"{probability} is out of range; must be from 0 to 1")
        if isinstance(names, str):
            raise UsageError("names", f"'{names}' is a string; pass a list, ['{names}']")
        if isinstance(severities, int):
            raise UsageError("severities", f"{severities} is a number; pass a list, [{severities}]")
        levels = tuple(sorted({check_severity(severity) for severity in severities}))
        self.choices: list[tuple[Corruption, tuple[int, ...]]] = []
        names = DEFAULT_NAMES if names is None else tuple(names)
        for name in names:
            corruption = load_corruption(name, variant, scale)
            self.choices.append((corruption, _levels(corruption.name, levels, scale)))
        if not self.choices or not levels:
            raise UsageError("names" if levels else "severities", "nothing to choose from; give at least one")
        self.names = tuple(corruption.name for corruption, _ in self.choices)
        self.severities = levels
        self.probability = probability
        self.seed = check_seed(seed)
        self.variant = variant
        self.scale = scale
        self._calls = 0

    def __call__(self, images: Image | Sequence[Image], key: str | int | None = None) -> Any:
        """Corrupt an image, a pair or a clip.

        Args:
            images: one image; a list or tuple of images (a pair or clip, corrupted with a single draw); or a clip as
                one array (N, H, W, 3).
            key: name of the random draw. The same seed, key and images always produce the same bytes.

        Returns:
            New arrays with the container, shape and dtype of the input. Corruptions operate on 8-bit values, so the
            values of float images become multiples of 1/255; if no corruption is applied, images are returned
            unchanged. Grey images remain grey: they are corrupted as RGB images with equal channels. If the corruption
            treats all channels alike, one of them is returned; otherwise (saturate, spatter, frost, psf_blur,
            raw_noise, your own), the luma (BT.601) is returned.

        Raises:
            DataError: the images have an unsupported dtype (16 bits, float64) or shape, or their sizes differ, or a
                float image contains NaN or values outside [0, 1].
        """
        several = images.ndim == 4 if isinstance(images, np.ndarray) else isinstance(images, list | tuple)
        frames: list[Image] = list(images) if several else [images]  # type: ignore[list-item]
        if not frames:
            raise DataError("images", "none given; pass at least one")
        for frame in frames:
            check_image(frame)
            if frame.shape != frames[0].shape:
                raise DataError(frame.shape, f"the images of a call differ in shape; the first is {frames[0].shape}")
        out = self._corrupt(frames, self._stream(key))
        if isinstance(images, np.ndarray):
            return np.stack(out) if several else out[0]
        return tuple(out) if isinstance(images, tuple) else out

    def _stream(self, key: str | int | None) -> Rng:
        if key is not None:
            return Rng.of("robustflow transform", self.seed, "key", key)
        with _COUNTING:
            self._calls += 1
            return Rng.of("robustflow transform", self.seed, *_process(), self._calls)

    def _corrupt(self, frames: list[Image], rng: Rng) -> list[Image]:
        if rng.uniform() >= self.probability:
            return [frame.copy() for frame in frames]
        corruption, levels = self.choices[rng.integer(0, len(self.choices))]
        severity = levels[rng.integer(0, len(levels))]
        state = corruption.draw(rng.spawn("draw"), severity, frames[0].shape[:2])
        return [
            _in_format_of(frame, corruption.apply(_rgb(frame), state, index), corruption.name)
            for index, frame in enumerate(frames)
        ]

    def __repr__(self) -> str:
        names = "the default" if self.names == DEFAULT_NAMES else list(self.names)
        parts = f"names={names}, severities={list(self.severities)}, probability={self.probability}, seed={self.seed}"
        parts += "" if self.variant == "default" else f", variant='{self.variant}'"
        parts += "" if self.scale == "paper" else f", scale='{self.scale}'"
        return f"{type(self).__name__}({parts})"


def check_image(image: Image) -> None:
    """Check that an image has a supported type, dtype, shape and value range.

    >>> check_image(np.zeros((8, 8, 3), np.uint16))  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    robustflow.core.errors.DataError: uint16: an image's dtype; corruptions operate on 8-bit values; convert it to uint8
    """
    if not isinstance(image, np.ndarray):
        raise DataError(type(image).__name__, "an image's type; expected an array (H, W, 3), (H, W) or (H, W, 1)")
    if image.dtype not in (np.uint8, np.float32):
        how = "corruptions operate on 8-bit values; convert it to uint8"
        if np.issubdtype(image.dtype, np.floating):
            how = "expected float32 in [0, 1], or uint8"
        raise DataError(image.dtype, f"an image's dtype; {how}")
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)) or 0 in image.shape:
        raise DataError(image.shape, "the shape of an image; expected (H, W, 3), or (H, W) or (H, W, 1) for grey")
    if image.dtype == np.float32:
        low, high = float(image.min()), float(image.max())
        if not (low >= 0.0 and high <= 1.0):
            raise DataError(f"{low:g} to {high:g}", "the values of a float image; they must be in [0, 1] and not NaN")


def _levels(name: str, levels: tuple[int, ...], scale: str) -> tuple[int, ...]:
    condition = condition_of(name)
    for part in condition.names:
        if part in CLIP:
            raise UsageError(part, "requires an entire clip, so a transform cannot apply it; remove it")
    if condition.needs_depth:
        raise UsageError(name, "requires depth, which is not available to a transform; remove it")
    own = condition.levels(levels, scale)
    if levels and not own:
        text = ", ".join(map(str, levels))
        raise UsageError(name, f"does not exist at the severities {text} on the {scale} scale; remove it")
    return own


def _process() -> tuple[str | int, ...]:
    """Return an identifier that distinguishes the draws of this process from those of its sibling processes."""
    data = sys.modules.get("torch.utils.data")
    worker = data.get_worker_info() if data is not None else None
    rank = ("rank", os.environ["RANK"]) if "RANK" in os.environ else ()
    if worker is not None:
        return "worker", int(worker.seed), *rank
    if multiprocessing.parent_process() is not None:
        return "process", multiprocessing.current_process().name, *rank
    return "main", *rank


def _rgb(image: Image) -> Frame:
    if image.dtype == np.float32:
        image = np.rint(image * np.float32(255)).astype(np.uint8)
    if image.ndim == 2:
        image = image[..., None]
    return np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:2], 3)))


def _in_format_of(image: Image, frame: Frame, name: str) -> Image:
    """Convert `frame` to the shape and dtype of `image`."""
    out: Image = frame
    if image.ndim == 2 or image.shape[2] == 1:
        # luma would weaken noise that is independent between channels
        grey = (
            frame[..., 0]
            if _NEUTRAL.issuperset(condition_of(name).names)
            else cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY)
        )
        out = np.ascontiguousarray(grey).reshape(image.shape)
    return out.astype(np.float32) / np.float32(255) if image.dtype == np.float32 else out
