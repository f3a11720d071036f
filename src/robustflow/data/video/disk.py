"""Estimate the disk space required for preparation from the first frames of the clips."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path

from ...core.errors import DataError
from ...media.images import png_bytes
from .codec import Encoder, even_size, lossless, rgb_to_i420
from .flow_interpolator import FlowInterpolator
from .interpolation import interpolate
from .prepare import Preparation, clip_timing
from .source import Source

PROBE = 8
"""Number of source frames encoded for the estimate."""

RELEASED_BYTES = 681 * 10**9
"""Size of the released GoPro-FC in bytes."""


@dataclass(frozen=True)
class DiskEstimate:
    """Bytes required permanently, additional bytes required while the largest clip is prepared, and free bytes."""

    masters: int
    key_frames: int
    temporary: int
    variants: int
    free: int

    @property
    def kept(self) -> int:
        """Return the size of masters and key frames in bytes."""
        return self.masters + self.key_frames

    def __str__(self) -> str:
        share = 100 * (self.kept + self.variants) / RELEASED_BYTES
        return (
            f"about {_gb(self.kept)} permanently (masters {_gb(self.masters)}, key frames {_gb(self.key_frames)}), "
            f"{_gb(self.temporary)} more during preparation, later up to {_gb(self.variants)} for transcoded variants "
            f"(in total {share:.2g} % of the released dataset's 681 GB); {_gb(self.free)} free"
        )


def estimate_disk(
    sources: Sequence[Source], output: Path, preparation: Preparation, cache_limit: int, workers: int = 1
) -> DiskEstimate:
    """Estimate the disk space from the first `PROBE` frames of every clip, always using the interpolator "flow"."""
    masters, key_frames, segments, variants = 0, 0, [0], 0
    for source in sources:
        timing = clip_timing(source, preparation)
        coded, picture = _bytes_per_frame(source, preparation.factor)
        masters += timing.count * coded
        key_frames += len(timing.key_frames) * picture
        variants += 15 * len(timing.key_frames) * picture
        segments.append(timing.count * coded if preparation.factor > 1 else 0)
    temporary = sum(sorted(segments)[-workers:])
    return DiskEstimate(masters, key_frames, temporary, min(variants, cache_limit), _free(output))


def check_room(estimate: DiskEstimate, output: Path) -> None:
    """Check that there is enough disk space."""
    if estimate.kept + estimate.temporary > estimate.free:
        raise DataError(output, f"not enough disk space: {estimate}; choose a different --output or fewer clips")


def _bytes_per_frame(source: Source, factor: int) -> tuple[int, int]:
    """Return the size in bytes of a master frame and of the PNG of a key frame."""
    probe = list(islice(source.frames(), PROBE))
    frames = list(interpolate(probe, FlowInterpolator(), factor)) if factor > 1 else probe
    height, width = even_size(*source.size)
    encoder = Encoder(height, width, Fraction(240), lossless("ultrafast"))
    packets = encoder.encode((index, rgb_to_i420(frame)) for index, frame in enumerate(frames))
    coded = sum(len(packet.data) for packet in packets) // len(frames)
    return coded, len(png_bytes(probe[0]))


def _free(output: Path) -> int:
    existing = next(folder for folder in (output.absolute(), *output.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free


def _gb(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 5e7 else f"{count / 1e6:.1f} MB"
