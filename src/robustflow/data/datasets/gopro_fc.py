"""The prepared GoPro-FC: pairs of key frames of clips, and the corruptions that need the whole clip.

Image corruptions are computed on the fly as for every dataset. Object motion blur, rolling shutter and the three video
corruptions are generated from the clip (see `data.video.open_clip`); the runner receives these frames corrupted.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...core.errors import UsageError
from ...core.files import cache_folder
from ...core.paths import user_path
from ...core.types import Frame, Sample
from ...corruptions.api import load_corruption
from ...corruptions.registry import CLIP, FAMILIES
from ...media.images import read_image
from ..video.open_clip import OpenClip, read_record, record_of_variant
from ..video.prepared import FolderCache, PreparedClip, read_folder
from .dataset import FC_PAPER, DatasetFacts
from .pair_files import Samples

VARIANTS = "variants"


class GoProFCPrepared(Samples):
    """Dataset for a folder made by `robustflow prepare gopro-fc`. Implements `Dataset` and `CorruptedClips`: the
    frames around a pair are key frames of the clip or of its corrupted stream.
    """

    name = "gopro_fc_prepared"
    has_flow = False
    facts = DatasetFacts(
        title="GoPro-FC, prepared",
        description="Pairs of key frames from clips at 960 frames per second, made by robustflow prepare gopro-fc.",
        ground_truth="none",
        clips="always",
        licence="CC BY 4.0 (derived from GoPro)",
        citation=f"{FC_PAPER}; Nah, Kim and Lee, CVPR 2017",
        layout="gopro_fc.json, GOPR0374_11_02/clip.json, GOPR0374_11_02/master.mp4, GOPR0374_11_02/keyframes",
        training_set="gopro",
        benchmark="gopro-fc",
    )

    def __init__(self, root: str | Path, variant: str = "default", cache: Path | None = None) -> None:
        self.root = user_path(root)
        manifest, self.clips = read_folder(self.root)
        self.variant = variant
        writable = os.access(self.root, os.W_OK)
        where = cache or (self.root / VARIANTS if writable else cache_folder(VARIANTS))
        self.cache = FolderCache(where, manifest.cache_limit)
        self._pairs = {
            f"{clip.name}/{first:06d}": (clip, first, second) for clip in self.clips for first, second in clip.pairs
        }
        self._parameters = {name: load_corruption(name, variant).severities for name in CLIP}
        self._open: OpenClip | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": None}

    def keys(self) -> list[str]:
        """Return the keys, `<clip>/<master index of the first frame>`."""
        return list(self._pairs)

    def load(self, key: str) -> Sample:
        clip, first, second = self._pair(key)
        frames = (read_image(clip.key_frame_path(first)), read_image(clip.key_frame_path(second)))
        return Sample(key, frames, group=clip.name)

    def files(self, key: str) -> list[Path]:
        clip, first, second = self._pair(key)
        return [clip.key_frame_path(first), clip.key_frame_path(second)]

    def around(self, key: str, reach: int) -> range:
        clip, first, _ = self._pair(key)
        frames = clip.manifest.key_frames
        place = frames.index(first)
        return range(-min(reach, place), min(reach + 2, len(frames) - place))

    def frame(self, key: str, offset: int) -> Frame:
        clip, index = self._key_frame(key, offset)
        return read_image(clip.key_frame_path(index))

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        key_frames = (self._key_frame(key, offset) for offset in sorted(set(offsets)))
        return [clip.key_frame_path(index) for clip, index in key_frames]

    def has_corrupted(self, corruption: str) -> bool:
        return corruption in CLIP

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """Return corrupted frames, which are generated on first use; a video corruption takes a pass over the clip."""
        first, second = (self.corrupted_frame(key, offset, corruption, severity) for offset in (0, 1))
        return first, second

    def corrupted_frame(self, key: str, offset: int, corruption: str, severity: int) -> Frame:
        clip, index = self._key_frame(key, offset)
        parameter = self._parameters[corruption][severity - 1]
        if self._open is None or self._open.clip is not clip:
            self._open = OpenClip(clip, self.cache, self._parameters)
        return self._open.corrupted(index, corruption, parameter)

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        return [self._pair(key)[0].master.path]

    def with_variant(self, variant: str) -> GoProFCPrepared:
        return self if variant == self.variant else GoProFCPrepared(self.root, variant, self.cache.root)

    def identity(self) -> dict[str, Any]:
        return {
            clip.name: clip.manifest.model_dump(include={"master_sha256", "fps", "step", "factor", "interpolator"})
            for clip in self.clips
        }

    def clip_records(self) -> list[dict[str, Any]]:
        """See `FromClips.clip_records`: one record per clip, video corruption and severity generated so far."""
        settings = [(name, parameter) for name in FAMILIES["video"] for parameter in self._parameters[name]]
        paths = [record_of_variant(clip, self.cache, *setting) for clip in self.clips for setting in settings]
        return [read_record(path) for path in paths if path.is_file()]

    def _key_frame(self, key: str, offset: int) -> tuple[PreparedClip, int]:
        clip, first, _ = self._pair(key)
        frames = clip.manifest.key_frames
        return clip, frames[frames.index(first) + offset]

    def _pair(self, key: str) -> tuple[PreparedClip, int, int]:
        if key not in self._pairs:
            raise UsageError(key, f"no such sample of {self.name}; keys look like '{next(iter(self._pairs))}'")
        return self._pairs[key]
