"""GoPro-FC: pairs of key frames from prepared clips, and what only the whole clip can give them.

Image corruptions are made on the fly like anywhere else. Object motion blur averages master frames decoded on
demand; the video corruptions transcode the master once per severity and keep the key frames in a cache of limited
size. To the runner all four are frames that come already corrupted (`PreCorrupted`).
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from ..atomic import make_folder, write_json
from ..corruptions.api import load_corruption
from ..corruptions.registry import CLIP, FAMILIES
from ..errors import UsageError
from ..images.io import read_image
from ..sample import Frame, Sample
from ..video.cache import FolderCache
from ..video.clip import ClipFile, ClipReader
from ..video.colour import i420_to_rgb
from ..video.object_motion import ObjectMotion
from ..video.prepare_folder import cache_folder
from ..video.prepared import FOLDER_RECORD, PreparedClip, read_folder
from ..video.variants import FRAMES_FILE, make_variant
from .facts import FC_PAPER, DatasetFacts
from .samples import Samples

VARIANTS = "variants"
RECORDS = ".records"


class GoProFC(Samples):
    """A folder made by `robustflow prepare gopro-fc`. Implements `Dataset` and `CorruptedClips`: further frames
    are further key frames of the clip, and of its corrupted stream.

    Args:
        root: the prepared folder.
        variant: of the corruptions' parameters, see `robustflow.corruptions.base`.
        cache: where transcoded variants are kept; by default in the prepared folder, or where that cannot be
            written, in the user's cache folder.

    Raises:
        DataError: not a prepared folder, or one that is not finished.
    """

    name = "gopro_fc"
    has_flow = False
    facts = DatasetFacts(
        title="GoPro-FC, prepared",
        description="Pairs of key frames of clips at 960 frames per second, made by robustflow prepare gopro-fc.",
        ground_truth="none",
        clips="always",
        licence="CC BY 4.0 (derived from GoPro)",
        citation=f"{FC_PAPER}; Nah, Kim and Lee, CVPR 2017",
        layout="gopro_fc.json, GOPR0374_11_02/clip.json, GOPR0374_11_02/master.mp4, GOPR0374_11_02/keyframes",
        training_set="gopro",
        benchmark="gopro-fc",
    )

    def __init__(self, root: str | Path, variant: str = "default", cache: Path | None = None) -> None:
        self.root = Path(root).expanduser()
        record, self.clips = read_folder(self.root)
        self.variant = variant
        writable = os.access(self.root, os.W_OK)
        where = cache or (self.root / VARIANTS if writable else cache_folder() / VARIANTS)
        self.cache = FolderCache(where, record.cache_limit)
        self._pairs = {
            f"{clip.name}/{first:06d}": (clip, first, second) for clip in self.clips for first, second in clip.pairs
        }
        self._parameters = {name: load_corruption(name, variant).severities for name in CLIP}
        self._open: _OpenClip | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": None}

    def keys(self) -> list[str]:
        """`<clip>/<master index of the first frame>`."""
        return list(self._pairs)

    def load(self, key: str) -> Sample:
        """A pair of adjacent key frames; the clip is its group."""
        clip, first, second = self._pair(key)
        frames = (read_image(clip.key_frame_path(first)), read_image(clip.key_frame_path(second)))
        return Sample(key, frames, group=clip.name)

    def files(self, key: str) -> list[Path]:
        """The two key frames."""
        clip, first, second = self._pair(key)
        return [clip.key_frame_path(first), clip.key_frame_path(second)]

    def around(self, key: str, reach: int) -> range:
        """See `Clips.around`."""
        clip, first, _ = self._pair(key)
        frames = clip.record.key_frames
        place = frames.index(first)
        return range(-min(reach, place), min(reach + 2, len(frames) - place))

    def frame(self, key: str, offset: int) -> Frame:
        """See `Clips.frame`."""
        clip, index = self._key_frame(key, offset)
        return read_image(clip.key_frame_path(index))

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """See `Clips.frame_files`."""
        found = (self._key_frame(key, offset) for offset in sorted(set(offsets)))
        return [clip.key_frame_path(index) for clip, index in found]

    def has_corrupted(self, corruption: str) -> bool:
        """True for the four that need the clip."""
        return corruption in CLIP

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """See `PreCorrupted.corrupted`; made on first use, which for a video corruption takes a pass over the clip.

        Warns (`UserWarning`) when it is made, where a damage changed nothing or cost frames.
        """
        first, second = (self.corrupted_frame(key, offset, corruption, severity) for offset in (0, 1))
        return first, second

    def corrupted_frame(self, key: str, offset: int, corruption: str, severity: int) -> Frame:
        """See `CorruptedClips.corrupted_frame`."""
        clip, index = self._key_frame(key, offset)
        parameter = self._parameters[corruption][severity - 1]
        if self._open is None or self._open.clip is not clip:
            self._open = _OpenClip(clip, self.cache, self._parameters["object_motion_blur"])
        if corruption == "object_motion_blur":
            return self._open.blurred(index, parameter)
        return self._open.transcoded(index, corruption, parameter)

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        """The clip's master: everything is made from it."""
        return [self._pair(key)[0].master.path]

    def with_variant(self, variant: str) -> GoProFC:
        """The same data with the parameters of a variant ("reference": 5 M for the worst bit errors)."""
        return self if variant == self.variant else GoProFC(self.root, variant, self.cache.root)

    def identity(self) -> dict[str, Any]:
        """What decides the frames: masters, key frames and how they were made. For a run's manifest and identity."""
        return {
            clip.name: clip.record.model_dump(include={"master_sha256", "fps", "step", "factor", "interpolator"})
            for clip in self.clips
        }

    def clip_records(self) -> list[dict[str, Any]]:
        """See `FromClips.clip_records`: one record per clip, video corruption and severity made so far."""
        settings = [(name, parameter) for name in FAMILIES["video"] for parameter in self._parameters[name]]
        names = [variant_name(clip, *setting) for clip in self.clips for setting in settings]
        paths = [self.cache.root / RECORDS / f"{name}.json" for name in names]
        return [json.loads(path.read_text(encoding="utf-8")) for path in paths if path.is_file()]

    def _key_frame(self, key: str, offset: int) -> tuple[PreparedClip, int]:
        """The clip of a sample and the master index of the key frame at an offset from the pair's first."""
        clip, first, _ = self._pair(key)
        frames = clip.record.key_frames
        return clip, frames[frames.index(first) + offset]

    def _pair(self, key: str) -> tuple[PreparedClip, int, int]:
        if key not in self._pairs:
            raise UsageError(f"gopro_fc has no sample '{key}'; keys look like '{next(iter(self._pairs))}'")
        return self._pairs[key]


class _OpenClip:
    """Readers of one clip: of its master, and of each variant's key frames."""

    def __init__(self, clip: PreparedClip, cache: FolderCache, reaches: tuple[int, ...]) -> None:
        self.clip = clip
        self._cache = cache
        self._master = ClipReader(clip.master)
        self._motion = ObjectMotion(self._master_frame, reaches)
        self._variants: dict[tuple[str, int], ClipReader] = {}

    def blurred(self, index: int, reach: int) -> Frame:
        """A key frame under object motion blur."""
        return self._motion.blurred(index, reach)

    def transcoded(self, index: int, corruption: str, parameter: int) -> Frame:
        """A key frame after a video corruption."""
        position = self.clip.record.key_frames.index(index)
        reader = self._variants.get((corruption, parameter))
        if reader is None:
            name = variant_name(self.clip, corruption, parameter)
            make = partial(self._make, corruption, parameter, self._cache.root / RECORDS / f"{name}.json")
            reader = self._cache.use(name, make, partial(self._reader, position))
            self._variants[corruption, parameter] = reader
        return self._rgb(reader, position)

    def _make(self, corruption: str, parameter: int, record_path: Path, folder: Path) -> None:
        record = make_variant(self.clip, corruption, parameter, folder)
        make_folder(record_path.parent)  # the record outlives the frames, which may be evicted
        write_json(record_path, record)
        for warning in record["warnings"]:
            warnings.warn(warning, stacklevel=2)

    def _reader(self, position: int, folder: Path) -> ClipReader:
        master = self.clip.master
        count = len(self.clip.record.key_frames)
        reader = ClipReader(ClipFile(folder / FRAMES_FILE, count, master.fps, master.height, master.width), keep=2)
        reader.picture(position)  # opens the file, which may then be evicted without harm
        return reader

    def _master_frame(self, index: int) -> Frame:
        return self._rgb(self._master, index)

    def _rgb(self, reader: ClipReader, index: int) -> Frame:
        return i420_to_rgb(reader.picture(index), reader.clip.height, reader.clip.width)


def variant_name(clip: PreparedClip, corruption: str, parameter: int) -> str:
    """The cache's name for a transcoded clip; another master is another name."""
    return f"{clip.name}-{clip.record.master_sha256[:12]}-{corruption}-{parameter}"


def prepare_video(path: Path) -> Path:
    """Prepare a video file as it is (no interpolation, key frames 1/30 s apart) in the user's cache folder.

    Returns the prepared folder; made on the first call, found on later ones.
    """
    from ..video.prepare import Settings
    from ..video.prepare_folder import find_sources, prepare_folder
    from ..video.prepared import sha256_of

    sources = find_sources(path)
    output = cache_folder() / "clips" / f"{path.stem}-{sha256_of(path)[:12]}"
    prepare_folder(sources, output, Settings(factor=1))
    return output


def is_prepared(data: Path) -> bool:
    """Whether a folder was made by `robustflow prepare gopro-fc`."""
    return (data / FOLDER_RECORD).is_file()


def slow_blur(clip: PreparedClip) -> Fraction | None:
    """Seconds that the most severe object motion blur averages over, where that is longer than the paper's 31/960."""
    span = 31 / clip.master.fps
    return span if span > Fraction(31, 960) else None
