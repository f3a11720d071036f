"""`Sample`, the record that passes from a dataset through corruptions and models to metrics, and other types that every
room uses: arrays, cameras, depth, and base classes of validated data.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

from .errors import DataError

Frame = npt.NDArray[np.uint8]
"""An RGB image, uint8, shape (H, W, 3)."""

Flow = npt.NDArray[np.float32]
"""Optical flow, float32, shape (H, W, 2): (u right, v down) in pixels of frame 1."""

Mask = npt.NDArray[np.bool_]
"""A boolean map, shape (H, W)."""

DepthMap = npt.NDArray[np.float32]
"""Depth along the optical axis in metres, float32, shape (H, W); positive and finite everywhere."""

TRUTHS = ("unchanged", "none")
"""What a corruption leaves of the ground truth: all of it or, if it moves the content of the frames, none."""

_LARGEST, _FARTHEST = 1e9, 1e6
"""Largest intrinsics in pixels, and largest translation along an axis in metres."""


def unmasked(array: Any) -> Any:
    """Replace the masked values of a NumPy masked array of floats by NaN; conversion to an array would reveal what the
    mask hides. Other objects are returned unchanged.

    >>> unmasked(np.ma.masked_greater([1.0, 2.0], 1.5)).tolist()
    [1.0, nan]
    """
    return array.filled(np.nan) if isinstance(array, np.ma.MaskedArray) and array.dtype.kind == "f" else array


def read_only(array: npt.NDArray[Any]) -> Any:
    """Return a view of an array that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, eq=False)
class Camera:
    """The pinhole camera of both frames, and its motion between them.

    Coordinates: x right, y down, z forward, in metres; pixel centres at integer positions.

    Attributes:
        focal: focal lengths (fx, fy), in pixels.
        centre: principal point (cx, cy), in pixels.
        rotation: rotation matrix, float64 (3, 3); None if the motion is unknown.
        translation: translation vector, float64 (3,), in metres; None if the motion is unknown. A point X in the
            coordinates of frame 1 is at `rotation @ X + translation` in the coordinates of frame 2.
        second: intrinsics (fx, fy, cx, cy) of frame 2, in pixels, if they differ from frame 1 because of a zoom or
            because frame 2 comes from the second camera of a stereo pair; else None.

    Raises:
        DataError: a focal length is not between 1e-3 and 1e9 px, a principal point is beyond 1e9 px, the rotation is
            not a rotation matrix, the translation is not (3,) or is beyond 1e6 m, or only one of the two is given.

    >>> Camera((500.0, 500.0), (320.0, 240.0)).intrinsics(1)
    (500.0, 500.0, 320.0, 240.0)
    """

    focal: tuple[float, float]
    centre: tuple[float, float]
    rotation: npt.NDArray[np.float64] | None = None
    translation: npt.NDArray[np.float64] | None = None
    second: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        for focal, centre in ((self.focal, self.centre), (self.intrinsics(1)[:2], self.intrinsics(1)[2:])):
            if not (len(focal) == len(centre) == 2 and all(1e-3 <= value <= _LARGEST for value in focal)):
                raise DataError("camera", f"focal lengths {focal}; expected (fx, fy), from 1e-3 to 1e9 px")
            if not all(abs(value) <= _LARGEST for value in centre):
                raise DataError(
                    "camera", f"principal point {centre}; expected (cx, cy), at most 1e9 px from the origin"
                )
        if (self.rotation is None) != (self.translation is None):
            raise DataError("camera", "give rotation and translation together")
        if self.rotation is None or self.translation is None:
            return
        turn, moved = np.asarray(self.rotation, np.float64), np.asarray(self.translation, np.float64)
        if turn.shape != (3, 3) or not (np.abs(turn @ turn.T - np.eye(3)) < 1e-3).all() or not np.linalg.det(turn) > 0:
            raise DataError("camera", "the rotation is not a rotation matrix of shape (3, 3)")
        if moved.shape != (3,) or not (np.abs(moved) <= _FARTHEST).all():
            raise DataError("camera", "the translation must have shape (3,) and be at most 1e6 m along each axis")

    def intrinsics(self, index: int) -> tuple[float, float, float, float]:
        """Return (fx, fy, cx, cy) of frame `index`, 0 or 1."""
        return self.second if index and self.second is not None else (*self.focal, *self.centre)


@dataclass(frozen=True, eq=False)
class SceneDepth:
    """The depth of a pair.

    Attributes:
        maps: dense depth maps of frames 1 and 2, float32 (H, W), in metres.
        measured: boolean masks (H, W) of the measured pixels of each map; the remaining pixels were filled in.
        camera: camera intrinsics, and the camera motion if known.

    Raises:
        DataError: there are not two maps and two masks, they have the wrong dtype or different sizes, or a depth is not
            positive and finite.
    """

    maps: tuple[DepthMap, DepthMap]
    measured: tuple[Mask, Mask]
    camera: Camera

    def __post_init__(self) -> None:
        arrays = (*self.maps, *self.measured)
        if not (len(self.maps) == len(self.measured) == 2 and all(isinstance(array, np.ndarray) for array in arrays)):
            raise DataError("depth", "give two NumPy maps, one for each frame, and their two masks")
        shape = self.maps[0].shape
        for number, (depth, measured) in enumerate(zip(self.maps, self.measured, strict=True), 1):
            if depth.dtype != np.float32 or depth.ndim != 2 or depth.shape != shape:
                raise DataError(f"depth map {number}", f"expected float32 {shape[:2]}, got {depth.dtype} {depth.shape}")
            if measured.dtype != np.bool_ or measured.shape != shape:
                raise DataError(
                    f"mask of depth map {number}", f"expected bool {shape}, got {measured.dtype} {measured.shape}"
                )
            if not (np.isfinite(depth).all() and (depth > 0).all()):
                raise DataError(f"depth map {number}", "every pixel must be positive and finite, in metres")


def described_array(value: Any) -> str:
    """Describe what was passed instead of an array, for error messages.

    >>> described_array(np.zeros((2, 3))), described_array("frame")
    ('float64 (2, 3)', 'str')
    """
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__


def check_frame(frame: Any, first: Frame, what: str) -> None:
    """Check that a frame is RGB uint8 (H, W, 3) and has the size of the first frame; `what` names it in errors."""
    is_bytes = isinstance(frame, np.ndarray) and frame.dtype == np.uint8
    if not is_bytes or frame.ndim != 3 or frame.shape[2] != 3 or not frame.size:
        raise DataError(what, f"expected RGB uint8 (H, W, 3), got {described_array(frame)}")
    if frame.shape != first.shape:
        raise DataError(
            what,
            f"frames differ in size, {first.shape[0]}x{first.shape[1]} and {frame.shape[0]}x{frame.shape[1]}; "
            "all frames of a pair or clip must have the same size",
        )


@dataclass(frozen=True, eq=False)
class Sample:
    """Frames that belong together, with ground truth if available.

    Attributes:
        key: the sample's name within its dataset, stable across machines (`"000010"`, `"alley_1/frame_0001"`).
        frames: two or more RGB uint8 images of the same shape (H, W, 3). Ground truth describes frames 0 -> 1.
        flow: ground-truth flow, float32 (H, W, 2), in pixels, or None. Values where `valid` is False are finite but
            meaningless.
        valid: boolean mask (H, W), True where the ground truth is known; None if and only if `flow` is None.
        occluded: boolean mask (H, W), True where the pixel of frame 0 is not visible in frame 1; None if the dataset
            has no such map.
        group: name shared by samples that are not independent (one video sequence); the key by default.
        depth: depth of frames 0 and 1, or None; only loaded for corruptions that need it.

    Raises:
        DataError: the frames differ in size or have the wrong dtype, or the ground truth does not match them.

    >>> import numpy as np
    >>> black = np.zeros((4, 6, 3), np.uint8)
    >>> Sample("a", (black, black)).shape
    (4, 6)
    """

    key: str
    frames: tuple[Frame, ...]
    flow: Flow | None = None
    valid: Mask | None = None
    occluded: Mask | None = None
    group: str = ""
    depth: SceneDepth | None = None
    meta: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.frames) < 2:
            raise DataError(f"sample '{self.key}'", f"optical flow needs two frames, not {len(self.frames)}")
        for index, frame in enumerate(self.frames):
            check_frame(frame, self.frames[0], f"sample '{self.key}', frame {index + 1}")
        if (self.flow is None) != (self.valid is None):
            raise DataError(f"sample '{self.key}'", "flow and valid mask must be given together")
        maps: list[tuple[str, Any, type, int]] = [
            ("flow", self.flow, np.float32, 3),
            ("valid mask", self.valid, np.bool_, 2),
            ("occlusion map", self.occluded, np.bool_, 2),
        ]
        if self.depth is not None:
            maps += [("depth map", array, array.dtype.type, 2) for array in (*self.depth.maps, *self.depth.measured)]
        for name, array, kind, dimensions in maps:
            expected = (*self.shape, 2)[:dimensions]
            fits = isinstance(array, np.ndarray) and array.dtype == kind and array.shape == expected
            if array is not None and not fits:
                given = described_array(array)
                raise DataError(
                    f"sample '{self.key}'",
                    f"the {name} is {given}; expected {np.dtype(kind)} {expected}, as the frames",
                )
        if not self.group:
            object.__setattr__(self, "group", self.key)

    def without_truth(self) -> Sample:
        """Return the sample without ground truth, as under a corruption that moves content."""
        return replace(self, flow=None, valid=None, occluded=None)

    @property
    def shape(self) -> tuple[int, int]:
        """Return the size (H, W) of the frames, in pixels."""
        height, width = self.frames[0].shape[:2]
        return height, width


class Frozen(BaseModel):
    """Immutable validated data; unknown fields are rejected."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FrozenFinite(Frozen):
    """Immutable validated data without infinite or NaN values, which JSON does not support."""

    model_config = ConfigDict(allow_inf_nan=False)


class Untrusted(FrozenFinite):
    """Immutable, finite validated data without type conversion: "3" is not a number. For untrusted files."""

    model_config = ConfigDict(strict=True)
