"""What a corruption is: draw once, then apply to every frame.

`draw` makes every random choice of a pair (or clip) and returns a state; `apply` is a pure function of
(frame, state, index). What the frames share is in the state; what changes from frame to frame is derived inside
`apply` from a stream spawned with the frame's index, so a clip of any length can be streamed and frame `i` of a clip
equals frame `i` of a pair.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

from ..errors import DataError, UsageError
from ..random.rng import Rng
from ..sample import Frame, SceneDepth
from ..severity import SEVERITIES, check_severity

VARIANTS = ("default", "reference", "paper")
"""`default`: the rule of docs/design/discrepancies.md; `reference`: the reference code's behaviour; `paper`: the
paper's text followed literally. If a corruption makes no difference, the three are the same."""

BGR = "reference-bgr"
"""Like `reference`, with BGR frames passed to code that expects RGB, as in the reference code: see channel_order."""

SCALES = ("paper", "calibrated")
"""`paper`: the paper's numbers. `calibrated`: equal mean SSIM for all corruptions (docs/severity-scales.md)."""


class Corruption(ABC):
    """One corruption at its five severities.

    Subclasses set `name`, `family` and `severities` (the paper's numbers, one entry per severity) and implement
    `draw` and `apply`. Instances carry no random state and may be shared between threads.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    temporal: ClassVar[bool] = False
    """Whether the paper calls it temporal: made for pairs and clips, not for single images."""
    paper_severities: ClassVar[tuple[Any, ...]]
    level: ClassVar[type[NamedTuple] | None] = None
    """The names of a severity's parameters, if it has several."""
    needs_depth: bool = False
    """Whether the depth of the sample decides the result; see `DepthCorruption`."""
    source_key: ClassVar[str] = ""
    """The name of `source` in a run's identity; empty if no user's file affects the result."""

    def __init__(self, variant: str = "default", severities: tuple[Any, ...] | None = None) -> None:
        """`severities` replaces the paper's five parameters (the calibrated scale does that); a None among them is a
        severity that does not exist."""
        if variant not in VARIANTS:
            raise UsageError(f"unknown variant '{variant}' of {self.name}: choose from {', '.join((*VARIANTS, BGR))}")
        self.variant = variant
        levels = severities if severities is not None else self.severities_of(variant)
        self.severities = tuple(map(self._named, levels))

    def _named(self, parameters: Any) -> Any:
        return parameters if self.level is None or parameters is None else self.level(*parameters)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        """The five parameters of a variant; override where the reference code's numbers differ."""
        return self.paper_severities

    def parameter(self, severity: int) -> Any:
        """The parameter of a severity, 1 (mild) to 5 (severe).

        Raises:
            UsageError: no such severity, or one that does not exist on this scale.
        """
        value = self.severities[check_severity(severity) - 1]
        if value is None:
            levels = [str(level) for level, known in zip(SEVERITIES, self.severities, strict=True) if known is not None]
            raise UsageError(
                f"{self.name} does not exist at severity {severity} of the calibrated scale: "
                + (f"choose from {', '.join(levels)}" if levels else "choose another corruption, or the paper's scale")
            )
        return value

    @property
    def source(self) -> str:
        """Identifies the user's files that affect the result, for a run's identity; empty if there are none.

        A class that overrides this also sets `source_key`.
        """
        return ""

    @abstractmethod
    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        """Make every random choice for frames of `shape` (H, W), and return the state for `apply`."""

    def draw_with_depth(self, rng: Rng, severity: int, shape: tuple[int, int], depth: SceneDepth | None) -> Any:
        """`draw` for a sample whose depth may be known; `corrupt_clip` calls it."""
        return self.draw(rng, severity, shape)

    @abstractmethod
    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        """Corrupt frame number `index` (0 is the first of the pair); RGB uint8 in, a new RGB uint8 array out.

        Frames before the pair have negative numbers, and are frames of the same clip like any other.
        """


def sample_without_depth(name: str) -> UsageError:
    """The error for a corruption that needs depth and is given none."""
    return UsageError(
        f"{name} needs the depth of the sample: choose a data set that has it ('robustflow list datasets'), "
        "or give your own with --depth DIR"
    )


class DepthCorruption(Corruption):
    """A corruption of the scene in three dimensions: it needs the depth of both frames.

    Subclasses implement `draw_scene` in place of `draw`; the state it returns holds whatever `apply` needs of the depth
    maps. Only frames 0 and 1 have depth, so frames around a pair cannot be corrupted.

    >>> import numpy as np
    >>> from robustflow.testing import check_corruption
    >>> class Dusk(DepthCorruption):
    ...     paper_severities = (400.0, 200.0, 100.0, 50.0, 25.0)
    ...     def draw_scene(self, rng, severity, depth):
    ...         return [np.exp(-metres / self.parameter(severity))[..., None] for metres in depth.maps]
    ...     def apply(self, frame, state, index):
    ...         return np.rint(frame * state[index]).astype(np.uint8)
    >>> check_corruption(Dusk)
    'dusk'
    """

    needs_depth = True

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        """Refused: there is no depth to draw from.

        Raises:
            UsageError: always.
        """
        raise sample_without_depth(self.name)

    def draw_with_depth(self, rng: Rng, severity: int, shape: tuple[int, int], depth: SceneDepth | None) -> Any:
        """The state for a sample with depth.

        Raises:
            UsageError: the sample has no depth.
            DataError: the depth maps and the frames differ in size.
        """
        if depth is not None and depth.maps[0].shape != shape:
            height, width = depth.maps[0].shape
            raise DataError(
                f"{self.name}: the depth maps are {width}x{height}, the frames {shape[1]}x{shape[0]}; "
                "give maps of the frames' size"
            )
        return self.draw(rng, severity, shape) if depth is None else self.draw_scene(rng, severity, depth)

    @abstractmethod
    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> Any:
        """Make every random choice for a pair, and return it with the depth that `apply` needs."""
