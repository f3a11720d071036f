"""Base classes for corruptions: draw once, then apply to every frame.

`draw` makes all random choices for a pair (or clip) and returns a state; `apply` is a pure function of (frame, state,
index). Values shared by the frames are stored in the state; per-frame values are derived inside `apply` from a stream
spawned with the frame's index. Clips of any length can therefore be streamed, and frame `i` of a clip is
identical to frame `i` of a pair.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

from ..core.arguments import SEVERITIES, check_severity
from ..core.errors import DataError, UsageError
from ..core.rng import Rng
from ..core.types import Frame, SceneDepth

VARIANTS = ("default", "reference", "paper")
"""`default` follows docs/design/discrepancies.md, `reference` follows the reference code, and `paper` follows the
paper's text literally. For many corruptions the three are identical.
"""

BGR = "reference-bgr"
"""Like `reference`, but BGR frames are passed to code that expects RGB, as in the reference code; see channel_order."""

SCALES = ("paper", "calibrated")
"""`paper` uses the paper's parameters; `calibrated` gives all corruptions the same mean SSIM (docs/severity-scales.md).
"""


class Corruption(ABC):
    """A corruption with five severities.

    Subclasses set `name` and `paper_severities` (one entry per severity), and implement `apply` and, if
    anything is random, `draw`. Instances have no random state and can be shared between threads.
    """

    name: str
    temporal: bool = False
    """Whether the paper calls the corruption temporal, i.e. designed for pairs and clips rather than single images."""
    paper_severities: tuple[Any, ...]
    level: ClassVar[type[NamedTuple] | None] = None
    """Names of the parameters, if a severity has several."""
    truth: str = "unchanged"
    """What the corruption leaves of the ground truth: "unchanged", or "none" if content moves to other pixels. Then
    only RCRE is measured, and no mean includes it together with other corruptions.
    """
    needs_depth: bool = False
    """Whether the corruption requires the depth of the sample; see `DepthCorruption`."""

    def __init__(self, variant: str = "default", severities: tuple[Any, ...] | None = None) -> None:
        """Create the corruption; `severities` overrides the paper's five parameters, e.g. for the calibrated scale.

        None marks a severity that does not exist on the scale.

        Raises:
            UsageError: the variant is unknown, or a severity is missing or has the wrong number of parameters.
        """
        if variant not in VARIANTS:
            raise UsageError(variant, f"not a variant of {self.name}; choose from {', '.join((*VARIANTS, BGR))}")
        self.variant = variant
        levels = severities if severities is not None else self.severities_of(variant)
        if len(levels) != len(SEVERITIES):
            raise UsageError(self.name, f"has {len(levels)} severities; define five, from mild to severe")
        self.severities = tuple(map(self._named, levels))

    def _named(self, parameters: Any) -> Any:
        if self.level is None or parameters is None:
            return parameters
        if not isinstance(parameters, tuple | list) or len(parameters) != len(self.level._fields):
            raise UsageError(
                self.name, f"a severity is {parameters!r:.60}; give the tuple ({', '.join(self.level._fields)})"
            )
        return self.level(*parameters)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        """Return the five parameters for a variant; override this method if the reference code uses different
        values.
        """
        return self.paper_severities

    def parameter(self, severity: int) -> Any:
        """Return the parameter for a severity, 1 (mild) to 5 (severe).

        Raises:
            UsageError: the severity is invalid or does not exist on this scale.
        """
        value = self.severities[check_severity(severity) - 1]
        if value is None:
            levels = [str(level) for level, parameter in enumerate(self.severities, 1) if parameter is not None]
            raise UsageError(
                self.name,
                f"does not exist at severity {severity} of the calibrated scale; "
                + (f"choose from {', '.join(levels)}" if levels else "choose another corruption or the paper's scale"),
            )
        return value

    @property
    def source(self) -> str:
        """Return an identifier of the user files that affect the result, for a run's identity; empty if there are
        none."""
        return ""

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        """Make all random choices for frames of `shape` (H, W) and return the state for `apply`.

        By default, nothing is random, and the state is the severity's parameter.
        """
        return self.parameter(severity)

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> Any:
        """Make all random choices for a pair, and return a state that includes the depth data needed by `apply`; only
        for a corruption that needs depth.
        """
        raise NotImplementedError

    def draw_with_depth(self, rng: Rng, severity: int, shape: tuple[int, int], depth: SceneDepth | None) -> Any:
        """Call `draw_scene` if the corruption needs depth, else `draw`; used by `corrupt_clip`.

        Raises:
            UsageError: the depth is missing, or not a `SceneDepth`.
            DataError: the depth maps have a different size.
        """
        if not self.needs_depth:
            return self.draw(rng, severity, shape)
        if depth is None:
            raise UsageError(
                self.name,
                "requires the depth of the sample; choose a dataset with depth ('robustflow list datasets'), "
                "or provide your own with --depth DIR",
            )
        if not isinstance(depth, SceneDepth):
            raise UsageError(
                self.name,
                f"depth is {type(depth).__name__}; pass a robustflow.SceneDepth with the maps of both "
                "frames and the camera",
            )
        if depth.maps[0].shape != shape:
            height, width = depth.maps[0].shape
            raise DataError(
                self.name,
                f"the depth maps are {height}x{width}, but the frames are {shape[0]}x{shape[1]}; the sizes must match",
            )
        return self.draw_scene(rng, severity, depth)

    @abstractmethod
    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        """Corrupt the frame with this `index` (0 is the first frame of the pair) and return a new RGB uint8 array.

        Frames of the clip before the pair have negative indices.
        """


class DepthCorruption(Corruption):
    """A corruption of the 3D scene, which needs the depth of both frames: subclasses implement `draw_scene`."""

    needs_depth = True

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        """Raise an error because depth is missing."""
        return self.draw_with_depth(rng, severity, shape, None)

    @abstractmethod
    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> Any:
        """See `Corruption.draw_scene`."""
