"""Pictures for a gallery: one frame of a pair under each corruption at each severity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ...corruptions import IMAGE_PAIR, Corruption, corrupt_clip, load_corruption
from ...corruptions.calibration.ssim import Ssim
from ...corruptions.stack import levels_of
from ...images.depth_colours import depth_colours
from ...sample import Frame, Sample


@dataclass(frozen=True)
class GalleryCell:
    """The frames under one corruption at one severity."""

    name: str
    severity: int
    frames: Sequence[Frame] = ()
    ssim: float | None = None
    remark: str = ""
    still: int = 0

    @property
    def caption(self) -> str:
        """The SSIM and the remark."""
        return ", ".join(filter(None, ("" if self.ssim is None else f"SSIM {self.ssim:.2f}", self.remark)))


def gallery(
    sample: Sample,
    severities: Sequence[int],
    corruptions: Sequence[str] | None = None,
    seed: int = 0,
    scale: str = "paper",
    classes: Mapping[str, type[Corruption]] = MappingProxyType({}),
) -> Iterator[GalleryCell]:
    """Yield the cells of a pair, one corruption after another; each shows the first frame that the corruption
    changes.
    """
    wanted = IMAGE_PAIR if corruptions is None else corruptions
    chosen = [load_corruption(name, scale=scale, classes=classes) for name in wanted]
    similarity = [Ssim(frame) for frame in sample.frames[:2]]
    if sample.depth is not None:
        near, far = (float(bound) for bound in (sample.depth.maps[0].min(), sample.depth.maps[0].max()))
        shown = depth_colours(sample.depth.maps[0])
        for severity in severities:
            yield GalleryCell("depth", severity, [shown], remark=f"{near:.3g} m (white) to {far:.3g} m")
    for corruption in chosen:
        for severity in severities:
            if severity in levels_of(corruption.name, tuple(severities), scale):
                clean = sample.frames[:2]
                frames = corrupt_clip(clean, corruption, severity, seed, sample.key, depth=sample.depth)
                frame, index = first_changed(frames, clean)
                yield GalleryCell(corruption.name, severity, [frame], similarity[index](frame), frame_remark(index))
            else:
                yield GalleryCell(corruption.name, severity)


def first_changed(frames: Iterable[Frame], clean: Sequence[Frame]) -> tuple[Frame, int]:
    """Return the first frame that differs from its clean frame, and its index, because some corruptions change only
    some of them; the first frame if none differs."""
    changed = ((frame, index) for index, frame in enumerate(frames) if not np.array_equal(frame, clean[index]))
    return next(changed, (clean[0], 0))


def frame_remark(index: int) -> str:
    """Return the remark that a still picture shows the frame at `index`; "" for the first frame.

    >>> frame_remark(1), frame_remark(0)
    ('frame 2', '')
    """
    return f"frame {index + 1}" if index else ""
