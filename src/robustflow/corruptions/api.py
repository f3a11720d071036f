"""Load corruptions by name and apply them to images, pairs and clips; identify the user's files that affect them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any, overload

import numpy as np
from PIL import Image

from ..core.arguments import check_severity
from ..core.errors import DataError, UsageError, unknown_name
from ..core.rng import Rng, check_seed
from ..core.types import Frame, SceneDepth, check_frame
from .condition import Stack, condition_of, with_targets_registered
from .corruption import BGR, SCALES, Corruption
from .registry import CORRUPTIONS, refuse_on_disk
from .scale import calibrated_severities
from .user_corruptions import OwnCorruption, own_corruption, register_custom


class ChannelsReversed(Corruption):
    """A corruption applied with red and blue swapped (variant "reference-bgr"); input and output frames are RGB.

    >>> import numpy as np
    >>> from robustflow.corruptions import load_corruption
    >>> red = np.zeros((16, 16, 3), np.uint8)
    >>> red[..., 0] = 200
    >>> as_red, as_blue = (load_corruption("jpeg_compression", v).apply(red, 25, 0) for v in ("reference", BGR))
    >>> as_red[0, 0].tolist() == as_blue[0, 0].tolist()
    False
    """

    def __init__(self, inner: Corruption) -> None:
        for attribute in ("name", "temporal", "truth", "paper_severities", "needs_depth"):
            setattr(self, attribute, getattr(inner, attribute))
        super().__init__(inner.variant, inner.severities)
        self.variant = BGR
        self._inner = inner

    @property
    def source(self) -> str:
        return self._inner.source

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        return self._inner.draw(rng, severity, shape)

    def draw_with_depth(self, rng: Rng, severity: int, shape: tuple[int, int], depth: SceneDepth | None) -> Any:
        return self._inner.draw_with_depth(rng, severity, shape, depth)

    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        corrupted = self._inner.apply(np.ascontiguousarray(frame[..., ::-1]), state, index)
        return np.ascontiguousarray(corrupted[..., ::-1])


_EIGHT_BITS = ("RGB", "L", "P", "1")


def as_frame(image: Any) -> Frame:
    """Convert an image to RGB uint8 (H, W, 3); arrays are returned unchanged and checked later.

    >>> as_frame(Image.new("L", (4, 3), 7)).shape
    (3, 4, 3)
    """
    if not isinstance(image, Image.Image):
        return image
    if image.mode not in _EIGHT_BITS or "transparency" in image.info:
        raise DataError(image.mode, "corruptions require 8-bit RGB images; use image.convert('RGB')")
    return np.asarray(image.convert("RGB"))


STREAM_VERSION = 3
"""Version of the corruptions' output. It is part of every run's identity and is incremented when the output of any
corruption changes, so that results from different versions are never mixed.
"""

_STREAMS = ("robustflow", 1)
"""Prefix of every random stream's name; incrementing the number in it changes all random draws."""

_PACKAGE = __name__.rpartition(".")[0] + "."


def load_corruption(
    name: str | Corruption | type[Corruption],
    variant: str = "default",
    scale: str = "paper",
    classes: Mapping[str, type[Corruption]] = MappingProxyType({}),
) -> Corruption:
    """Return the corruption registered as `name`, or the stack described by a name such as
    `"fog+jpeg_compression:2"`.
    """
    if scale not in SCALES:
        raise unknown_name("severity scale", str(scale), SCALES)
    if isinstance(name, OwnCorruption | Stack):
        return name
    if not isinstance(name, str):
        if type(name).__module__.startswith(_PACKAGE) and isinstance(name, Corruption):
            return name
        return load_corruption(register_custom(name), variant, scale)
    if (condition := condition_of(name)).is_stack:
        return Stack([(load_corruption(part, variant, scale, classes), level) for part, level in condition.parts])
    refuse_on_disk(name)
    own = own_corruption(name, variant)
    if own is not None:
        if scale == "paper":
            return own
        raise UsageError(name, "not on the calibrated scale; use --severity-scale paper")
    kind = classes.get(name) or CORRUPTIONS.get(name)
    if variant == BGR and scale == "paper":
        return ChannelsReversed(kind("reference"))
    if scale == "paper":
        return kind(variant)
    if variant != "default":
        raise UsageError(variant, "the calibrated scale exists only for the default variant; remove one of the two")
    return kind(variant, calibrated_severities(name))


def list_corruptions() -> list[str]:
    """Return the names that `load_corruption` supports, in the paper's order, followed by those from installed
    packages.

    >>> list_corruptions()[:3]
    ['jpeg_compression', 'pixelate', 'contrast']
    """
    return list(CORRUPTIONS.names())


def corruption_name(spec: str | Corruption | type[Corruption]) -> str:
    """Return the name under which a corruption is run and reported; custom corruptions are registered under that
    name.
    """
    return with_targets_registered(spec) if isinstance(spec, str) else load_corruption(spec).name


def corruption_names(specs: Iterable[str | Corruption | type[Corruption]]) -> tuple[str, ...]:
    """Return the distinct names under which corruptions are run and reported, see `corruption_name`."""
    names: list[str] = []
    own: dict[str, OwnCorruption] = {}
    for spec in specs:
        names.append(corruption_name(spec.made if isinstance(spec, OwnCorruption) else spec))
        for loaded in (own_corruption(part, "default") for part in condition_of(names[-1]).names):
            first = loaded and own.setdefault(loaded.name, loaded)
            if loaded and first and first.made is not loaded.made and first.source != loaded.source:
                raise UsageError(first.name, "two corruptions have this name; give each a different `name`")
        if isinstance(spec, Corruption) and not _equals_registered(spec, names[-1]):
            raise UsageError(
                names[-1],
                "an object of this corruption cannot be run; pass its name, and the options `variant` and "
                "`severity_scale`",
            )
    return tuple(dict.fromkeys(names))


def _equals_registered(corruption: Corruption, name: str) -> bool:
    loaded = load_corruption(name)
    return isinstance(loaded, OwnCorruption) or (type(loaded) is type(corruption) and vars(loaded) == vars(corruption))


def stream_for(corruption: Corruption, severity: int, seed: int, key: str) -> Rng:
    """Return the random stream for a benchmark seed, corruption, severity and sample key."""
    return Rng.of(*_STREAMS, check_seed(seed), corruption.name, severity, key)


@overload
def corrupt(
    frame1: Frame,
    frame2: Frame,
    corruption: str | Corruption | type[Corruption],
    severity: int,
    seed: int = ...,
    key: str = ...,
    variant: str = ...,
    scale: str = ...,
    depth: SceneDepth | None = ...,
) -> tuple[Frame, Frame]: ...


@overload
def corrupt(frame1: Any, frame2: Any = ..., *args: Any, **kwargs: Any) -> Any: ...


def corrupt(
    frame1: Any,
    frame2: Any = None,
    corruption: str | Corruption | type[Corruption] = "",
    severity: int | None = None,
    seed: int = 0,
    key: str = "",
    variant: str = "default",
    scale: str = "paper",
    depth: SceneDepth | None = None,
) -> Any:
    """Corrupt a pair of frames, or a single image.

    Args:
        frame1, frame2: frames of the same size, RGB uint8 (H, W, 3) or Pillow images; for Pillow images, RGB Pillow
            images are returned. Without `frame2`, the image is treated as the first frame of a pair, so a corruption
            that changes only one of the two frames (`over_exposure`, `under_exposure`) leaves the image unchanged in
            half of the draws.
        corruption: name of a corruption (`robustflow list corruptions`), `module.path:Attribute`, or a custom
            corruption.
        severity: severity, 1 (mild) to 5 (severe).
        seed: seed of the benchmark.
        key: name of the pair; pairs with different keys get different draws.
        variant: "default", "reference" (the reference code's behaviour), "reference-bgr" (also applied to frames in BGR
            order, as in the published results) or "paper" (following the paper's text literally).
        scale: severity scale, "paper" or "calibrated"; variant and scale are ignored for an object from
            `load_corruption`.
        depth: depth maps of both frames, for corruptions in the "depth" family.

    Returns:
        Two new frames of the same shape, or one for a single image. The same arguments always produce the same bytes.

    Raises:
        UsageError: the name, variant, scale or severity is unknown or missing, or the scale lacks the severity.
        DataError: the frames are not RGB uint8 of the same size, or the depth maps have a different size.

    >>> import numpy as np
    >>> grey = np.full((32, 48, 3), 128, np.uint8)
    >>> a, b = corrupt(grey, grey, "gaussian_noise", severity=3, seed=7)
    >>> a.shape, bool((a == b).all())
    ((32, 48, 3), False)
    >>> bool((corrupt(grey, corruption="gaussian_noise", severity=3, seed=7) == a).all())
    True
    """
    if isinstance(corruption, str) and not corruption:
        raise UsageError("corruption", "missing; for example: corrupt(frame1, frame2, 'fog', severity=3)")
    if severity is None:
        raise UsageError("severity", "missing; give 1 (mild) to 5 (severe)")
    given = (frame1,) if frame2 is None else (frame1, frame2)
    frames = tuple(as_frame(frame) for frame in given)
    clip = corrupt_clip(frames, corruption, severity, seed, key, variant, scale, depth=depth)
    pairs = zip(clip, given, strict=True)
    out = tuple(Image.fromarray(frame) if isinstance(image, Image.Image) else frame for frame, image in pairs)
    return out if len(out) > 1 else out[0]


def corrupt_clip(
    frames: Iterable[Frame],
    corruption: str | Corruption | type[Corruption],
    severity: int,
    seed: int = 0,
    key: str = "",
    variant: str = "default",
    scale: str = "paper",
    first: int = 0,
    depth: SceneDepth | None = None,
) -> Iterator[Frame]:
    """Corrupt the frames of a clip one at a time.

    Shared parameters are drawn once, and per-frame parameters are drawn for each frame. Accepts the same arguments as
    `corrupt`, plus `first`, the index of the first frame in `frames`; `depth` refers to frames 0 and 1. Frames 0 and 1
    are identical to the pair that `corrupt` returns for the same seed and key; frames before the pair have negative
    indices. Yields RGB uint8 arrays and keeps only one frame in memory at a time.

    Raises:
        UsageError, DataError: as for `corrupt`, or the clip is empty.

    >>> import numpy as np
    >>> clip = [np.full((32, 48, 3), level, np.uint8) for level in (90, 100, 110, 120)]
    >>> pair = corrupt(clip[2], clip[3], "snow", 3)
    >>> whole = list(corrupt_clip(clip, "snow", 3, first=-2))
    >>> bool((whole[2] == pair[0]).all() and (whole[3] == pair[1]).all())
    True
    """
    chosen = load_corruption(corruption_name(corruption) if isinstance(corruption, str) else corruption, variant, scale)
    severity = check_severity(severity)
    rest = iter(frames)
    try:
        head = next(rest)
    except StopIteration:
        raise UsageError("frames", "a clip needs at least one frame") from None
    check_frame(head, head, "frame 1")
    height, width = head.shape[:2]
    rng = stream_for(chosen, severity, seed, key)
    state: Any = chosen.draw_with_depth(rng, severity, (height, width), depth)
    return _applied(chosen, chain((head,), rest), head, state, first)


def _applied(corruption: Corruption, frames: Iterable[Frame], head: Frame, state: Any, first: int) -> Iterator[Frame]:
    for number, frame in enumerate(frames):
        check_frame(frame, head, f"frame {number + 1}")
        if corruption.needs_depth and first + number not in (0, 1):
            raise UsageError(
                corruption.name,
                "needs depth, which only the two frames of a pair have; use pairs and a model with two input frames",
            )
        yield corruption.apply(frame, state, first + number)


def user_sources(corruptions: Iterable[Corruption] = (), variant: str = "default") -> dict[str, Any]:
    """Return identifiers of the user files in use: those of the lenses, and the source of each custom corruption or one
    from an installed package, by name."""
    parts = chain.from_iterable(one.parts if isinstance(one, Stack) else (one,) for one in corruptions)
    own = {part.name: part.source for part in parts if isinstance(part, OwnCorruption)}
    sources = {"psf": load_corruption("psf_blur", variant).source, "corruptions": own}
    return {key: source for key, source in sources.items() if source}
