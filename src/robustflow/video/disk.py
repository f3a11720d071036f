"""Estimate the disk space that preparation needs from the first frames of the clips."""

from __future__ import annotations

import io
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path

from PIL import Image

from ..errors import DataError
from .codec import Encoder, lossless
from .colour import even_size, rgb_to_i420
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
    """Bytes needed permanently, additional bytes needed while the largest clip is prepared, and free bytes."""

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
            f"about {_gb(self.kept)} will stay (masters {_gb(self.masters)}, key frames {_gb(self.key_frames)}), "
            f"{_gb(self.temporary)} more while it is made, later at most {_gb(self.variants)} of transcoded variants "
            f"(all together {share:.2g} % of the released set's 681 GB); {_gb(self.free)} are free"
        )


def estimate_disk(
    sources: Sequence[Source], output: Path, preparation: Preparation, cache_limit: int, workers: int = 1
) -> DiskEstimate:
    """Estimate from the first `PROBE` frames of every clip, always interpolated by flow.

    The probe is encoded with a fast preset and starts with an intra-coded frame, so the estimate is an overestimate.

    Raises:
        DataError: a clip is too short or unreadable.
    """
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
    """Raise if there is not enough room.

    Raises:
        DataError: there is less free space than masters, key frames and temporary files need.
    """
    if estimate.kept + estimate.temporary > estimate.free:
        raise DataError(f"{output}: not enough room: {estimate}; choose a different --output, or fewer clips")


def _bytes_per_frame(source: Source, factor: int) -> tuple[int, int]:
    """Return the size in bytes of a master frame and of a key frame's PNG."""
    probe = list(islice(source.frames(), PROBE))
    frames = list(interpolate(probe, FlowInterpolator(), factor)) if factor > 1 else probe
    height, width = even_size(*source.size)
    encoder = Encoder(height, width, Fraction(240), lossless("ultrafast"))
    packets = encoder.encode((index, rgb_to_i420(frame)) for index, frame in enumerate(frames))
    coded = sum(len(packet.data) for packet in packets) // len(frames)
    buffer = io.BytesIO()
    Image.fromarray(probe[0]).save(buffer, "PNG", compress_level=3)
    return coded, len(buffer.getvalue())


def _free(output: Path) -> int:
    existing = next(folder for folder in (output.absolute(), *output.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free


def _gb(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 5e7 else f"{count / 1e6:.1f} MB"
