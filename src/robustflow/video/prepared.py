"""Define and read the output folder of `robustflow prepare`.

gopro_fc.json                      the clips and the settings used to prepare them
GOPR0374_11_02/clip.json           written last; missing if the clip is unfinished
GOPR0374_11_02/master.mp4          every frame, lossless yuv420p
GOPR0374_11_02/keyframes/000032.png
variants/...                       transcoded on demand, see `cache`
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field, ValidationError

from ..errors import DataError
from ..sealed import unsealed
from ..validated import Frozen
from .clip import ClipFile

FOLDER_MANIFEST = "gopro_fc.json"
CLIP_MANIFEST = "clip.json"
MASTER = "master.mp4"
KEY_FRAMES = "keyframes"
VERSION = 3

REACH = 15
"""Number of master frames on each side of a key frame that object motion blur averages at the highest severity."""

CACHE_LIMIT = 20 * 10**9


ClipName = Annotated[str, Field(pattern=r"^[^/\\.][^/\\]*$")]
"""Name of a clip; it must be a valid folder name, so that a manifest cannot refer to files outside its folder."""


class ClipManifest(Frozen):
    """The content of `clip.json`."""

    version: int
    name: ClipName
    count: int = Field(gt=0)
    fps: str = Field(pattern=r"^[1-9]\d{0,9}(/[1-9]\d{0,9})?$")
    height: int = Field(gt=0, lt=2**15)
    width: int = Field(gt=0, lt=2**15)
    factor: int = Field(gt=0)
    step: int = Field(gt=0)
    key_frames: list[Annotated[int, Field(ge=0)]]
    padded_to_even: bool
    preset: str
    source: dict[str, Any]
    interpolator: dict[str, Any] | None
    encoder: dict[str, str]
    master_sha256: str


class FolderManifest(Frozen):
    """The content of `gopro_fc.json`: the clips and the cache limit for transcoded variants in bytes."""

    version: int
    clips: list[ClipName]
    cache_limit: int = CACHE_LIMIT


R = TypeVar("R", ClipManifest, FolderManifest)


class PreparedClip:
    """A finished clip in a prepared folder."""

    def __init__(self, folder: Path, manifest: ClipManifest) -> None:
        self.folder = folder
        self.manifest = manifest

    @property
    def name(self) -> str:
        """Return the name of the clip (sequence)."""
        return self.manifest.name

    @property
    def master(self) -> ClipFile:
        """Return the lossless master."""
        r = self.manifest
        return ClipFile(self.folder / MASTER, r.count, Fraction(r.fps), r.height, r.width)

    def key_frame_path(self, index: int) -> Path:
        """Return the path of the PNG file for key frame `index` of the master."""
        return self.folder / KEY_FRAMES / f"{index:06d}.png"

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Return pairs of adjacent key frames, as indices of master frames."""
        return list(zip(self.manifest.key_frames, self.manifest.key_frames[1:], strict=False))


def choose_key_frames(count: int, step: int) -> list[int]:
    """Return the indices of every `step`-th frame except the first and the last of them (paper appendix, "GoPro-
    FC").
    """
    inner = range(0, count, step)[1:-1]
    return [index for index in inner if REACH <= index < count - REACH]


def read_folder(root: Path) -> tuple[FolderManifest, list[PreparedClip]]:
    """Read the clips of a prepared folder."""
    manifest = _read(root / FOLDER_MANIFEST, FolderManifest)
    clips = []
    for name in manifest.clips:
        if not (root / name / CLIP_MANIFEST).is_file():
            raise DataError(f"{root}: {name} is not finished; run the same robustflow prepare command again")
        clips.append(PreparedClip(root / name, _read(root / name / CLIP_MANIFEST, ClipManifest)))
    return manifest, clips


def parse_manifest(path: Path, kind: type[R]) -> R | None:
    """Read `clip.json` or `gopro_fc.json`; None if it is damaged or was not written by `robustflow prepare`."""
    try:
        return kind.model_validate_json(unsealed(path.read_bytes()) or b"")
    except ValidationError:
        return None


def _read(path: Path, kind: type[R]) -> R:
    try:
        manifest = parse_manifest(path, kind)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); was it created by robustflow prepare?") from error
    if manifest is None:
        raise DataError(f"{path}: not written by robustflow prepare, or damaged; prepare the clips again")
    if manifest.version != VERSION:
        raise DataError(f"{path}: written by a different version of RobustFlow; prepare the clips again")
    return manifest


def is_prepared(data: Path) -> bool:
    """Return whether a folder was created by `robustflow prepare gopro-fc`."""
    return (data / FOLDER_MANIFEST).is_file()


def slow_blur(clip: PreparedClip) -> Fraction | None:
    """Return the longest averaging time of object motion blur in seconds if it exceeds the paper's 31/960 s, else
    None.
    """
    span = (2 * REACH + 1) / clip.master.fps
    return span if span > Fraction(2 * REACH + 1, 960) else None
