"""Pictures for a gallery: one frame of a pair under each corruption at each severity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ...corruptions import IMAGE_PAIR, Corruption, corrupt_clip, load_corruption
from ...corruptions.calibration.ssim import Ssim
from ...corruptions.stack import levels_of
from ...images.depth_colours import depth_colours
from ...sample import Frame, Sample, SceneDepth


@dataclass(frozen=True)
class CorruptedPicture:
    """A picture in the gallery.

    Attributes:
        name: name of the corruption.
        severity: severity, 1 to 5.
        frame: first frame of the pair that the corruption changes, RGB uint8 (H, W, 3); None if the scale does not have
            this severity.
        index: index of this frame, 0 or 1.
        ssim: mean SSIM between this frame and the clean frame.
        caption: caption shown instead of the SSIM.
    """

    name: str
    severity: int
    frame: Frame | None = None
    index: int = 0
    ssim: float = 1.0
    caption: str = ""


def gallery(
    frame1: Frame,
    frame2: Frame,
    severities: Sequence[int],
    corruptions: Sequence[str] | None = None,
    seed: int = 0,
    key: str = "",
    scale: str = "paper",
    classes: Mapping[str, type[Corruption]] = MappingProxyType({}),
    depth: SceneDepth | None = None,
) -> Iterator[CorruptedPicture]:
    """Yield the cells, one corruption after another.

    Args:
        frame1, frame2: frames of equal size, RGB uint8 (H, W, 3).
        severities: severities, 1 to 5.
        corruptions: names of corruptions or stacks; all image-pair corruptions by default.
        seed, key: seed and key of the random draws; the frames are equal to those from `corrupt`.
        scale: severity scale, "paper" or "calibrated".
        classes: user-defined corruption classes, see `load_corruption`.
        depth: depth of the pair, for corruptions that need it; shown as the first cell.

    Raises:
        UsageError: the corruption or scale is unknown, or the corruption needs a clip.
        DataError: the frames are not a valid pair.

    >>> grey = np.full((32, 48, 3), 128, np.uint8)
    >>> [(cell.name, cell.severity, cell.index) for cell in gallery(grey, grey, [1, 2], ["contrast"])]
    [('contrast', 1, 0), ('contrast', 2, 0)]
    """
    pair = Sample(key or "pair", (frame1, frame2)).frames
    wanted = IMAGE_PAIR if corruptions is None else corruptions
    chosen = [load_corruption(name, scale=scale, classes=classes) for name in wanted]
    similarity = [Ssim(frame) for frame in pair]
    if depth is not None:
        near, far = (float(bound) for bound in (depth.maps[0].min(), depth.maps[0].max()))
        shown = depth_colours(depth.maps[0])
        for severity in severities:
            yield CorruptedPicture("depth", severity, shown, caption=f"{near:.3g} m (white) to {far:.3g} m")
    for corruption in chosen:
        for severity in severities:
            if severity in levels_of(corruption.name, tuple(severities), scale):
                frame, index = _changed(pair, corruption, severity, seed, key, depth)
                yield CorruptedPicture(corruption.name, severity, frame, index, similarity[index](frame))
            else:
                yield CorruptedPicture(corruption.name, severity)


def _changed(
    pair: Sequence[Frame], corruption: Corruption, severity: int, seed: int, key: str, depth: SceneDepth | None
) -> tuple[Frame, int]:
    """Return the first frame that the corruption changed, because some corruptions change only one of them; frame 1 if
    neither changed."""
    unchanged = pair[0]
    for index, frame in enumerate(corrupt_clip(pair, corruption, severity, seed, key, depth=depth)):
        if not np.array_equal(frame, pair[index]):
            return frame, index
    return unchanged, 0
