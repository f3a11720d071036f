"""Prepare and corrupt a small clip on this machine, and compare the frames with stored hashes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

from ...core.files import quick_digest_of_bytes
from ...corruptions import load_corruption
from ...corruptions.machine_check import SEVERITIES, compare, moving_frames
from ...corruptions.registry import CLIP
from .clip import write_clip
from .codec import crf, rgb_to_i420
from .open_clip import OpenClip
from .prepare import Preparation, prepare_clip
from .prepared import CACHE_LIMIT, FolderCache, PreparedClip
from .source import VideoFile

DIGESTS = resources.files(__package__) / "data" / "digests.json"
_FRAMES, _FPS = 14, Fraction(240)
_PREPARATION = Preparation(factor=4, step=1, interpolator="flow")
_DIVISORS = {"h264_abr": 16, "bit_error": 10_000}
"""Divisors of the parameters (bits per second, bytes per error), because the clip is much smaller than a real one."""


def compare_with_package() -> Iterator[tuple[str, str]]:
    """Yield each clip corruption with a description of how this machine's frames differ (empty if they are
    identical).
    """
    with TemporaryDirectory() as folder:
        digests = partial(digests_of, clip=prepared_clip(Path(folder)))
        yield from compare(CLIP, digests, DIGESTS)


def prepared_clip(folder: Path) -> PreparedClip:
    pictures = [rgb_to_i420(frame) for frame in moving_frames(_FRAMES)]
    height, width = pictures[0].shape[0] * 2 // 3, pictures[0].shape[1]
    source = write_clip(folder / "source.mp4", pictures, (height, width), _FPS, crf(23))
    return prepare_clip(VideoFile(source.path), folder / "prepared", _PREPARATION)


def digests_of(name: str, clip: PreparedClip) -> dict[str, str]:
    values = tuple(value // _DIVISORS.get(name, 1) for value in load_corruption(name).severities)
    opened = OpenClip(clip, FolderCache(clip.folder / "variants", CACHE_LIMIT), dict.fromkeys(CLIP, values))
    digests = {}
    for severity in SEVERITIES:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # bit errors may lose frames
            frames = [opened.corrupted(index, name, values[severity - 1]) for index in clip.manifest.key_frames]
        digests[str(severity)] = quick_digest_of_bytes(*(frame.tobytes() for frame in frames))
    return digests
