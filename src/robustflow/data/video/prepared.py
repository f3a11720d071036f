"""The output folder of `robustflow prepare`, and the cache of the variants in it.

gopro_fc.json                      the clips and the settings used to prepare them
GOPR0374_11_02/clip.json           written last; missing if the clip is unfinished
GOPR0374_11_02/master.mp4          every frame, lossless yuv420p
GOPR0374_11_02/keyframes/000032.png
variants/...                       transcoded on demand, see `cache`
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, TypeVar

from filelock import FileLock
from pydantic import Field, ValidationError

from ...core.errors import DataError
from ...core.files import digest_of_value, make_folder, quick_digest_of_file, unsealed
from ...core.types import Frozen
from .clip import ClipFile

T = TypeVar("T")

_DIGEST = ".digest"


class FolderCache:
    """A cache of named folders in `root`, at most `limit` bytes in total, shared between processes."""

    def __init__(self, root: Path, limit: int) -> None:
        self.root = root
        self.limit = limit

    def use(self, name: str, make: Callable[[Path], object], read: Callable[[Path], T]) -> T:
        make_folder(self.root)
        entry = self.root / name
        while True:
            with locked(self.root / f".{name}.lock"):
                if not _is_intact(entry):
                    shutil.rmtree(entry, ignore_errors=True)
                    self._make(entry, make)
            with locked(self.root / ".all.lock"):
                if entry.is_dir():  # another process may have evicted the entry in the meantime
                    os.utime(entry)
                    return read(entry)

    def _make(self, entry: Path, make: Callable[[Path], object]) -> None:
        temporary = self.root / f".making-{entry.name}"
        shutil.rmtree(temporary, ignore_errors=True)  # left behind by a killed process
        try:
            make(temporary)
            (temporary / _DIGEST).write_text(_digest(temporary))
            temporary.rename(entry)
        except OSError as error:
            raise DataError(entry, f"cannot be written ({error.strerror or error}); is the disk full?") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        self._evict(keep=entry)

    def _evict(self, keep: Path) -> None:
        with locked(self.root / ".all.lock"):
            entries = sorted((e for e in self.entries() if e != keep), key=lambda e: e.stat().st_mtime)
            used = _size(keep) + sum(map(_size, entries))
            for entry in entries:
                if used <= self.limit:
                    return
                used -= _size(entry)
                shutil.rmtree(entry, ignore_errors=True)

    def entries(self) -> list[Path]:
        if not self.root.is_dir():
            return []
        return sorted(entry for entry in self.root.iterdir() if entry.is_dir() and not entry.name.startswith("."))


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock on a file while the context is active; wait while another process holds it."""
    try:
        # The operating system releases this lock when the process dies, whereas a plain lock file remains after a kill.
        lock = FileLock(path, fallback_to_soft=False)
        lock.acquire()
    except OSError as error:
        raise DataError(path.parent, f"cannot be written ({error.strerror or error}); check its owner") from error
    try:
        yield
    finally:
        lock.release()


def _is_intact(entry: Path) -> bool:
    try:
        return (entry / _DIGEST).read_text() == _digest(entry)
    except (OSError, ValueError):
        return False


def _digest(folder: Path) -> str:
    """Hash the names and contents of a folder's files (top level only)."""
    files = sorted(path for path in folder.iterdir() if path.name != _DIGEST)
    return digest_of_value([(path.name, quick_digest_of_file(path)) for path in files], size=16)


def _size(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


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
    def __init__(self, folder: Path, manifest: ClipManifest) -> None:
        self.folder = folder
        self.manifest = manifest

    @property
    def name(self) -> str:
        return self.manifest.name

    @property
    def master(self) -> ClipFile:
        r = self.manifest
        return ClipFile(self.folder / MASTER, r.count, Fraction(r.fps), r.height, r.width)

    def key_frame_path(self, index: int) -> Path:
        return self.folder / KEY_FRAMES / f"{index:06d}.png"

    @property
    def pairs(self) -> list[tuple[int, int]]:
        return list(zip(self.manifest.key_frames, self.manifest.key_frames[1:], strict=False))


def choose_key_frames(count: int, step: int) -> list[int]:
    """Return the indices of every `step`-th frame but the first and the last (paper appendix, "GoPro-FC")."""
    inner = range(0, count, step)[1:-1]
    return [index for index in inner if REACH <= index < count - REACH]


def read_folder(root: Path) -> tuple[FolderManifest, list[PreparedClip]]:
    manifest = read_manifest(root / FOLDER_MANIFEST, FolderManifest)
    clips = []
    for name in manifest.clips:
        if not (root / name / CLIP_MANIFEST).is_file():
            raise DataError(root / name, "not finished; run the same robustflow prepare command again")
        clips.append(PreparedClip(root / name, read_manifest(root / name / CLIP_MANIFEST, ClipManifest)))
    return manifest, clips


def read_manifest(path: Path, kind: type[R]) -> R:
    """Read `clip.json` or `gopro_fc.json`, which may come from another machine."""
    try:
        manifest = kind.model_validate_json(unsealed(path.read_bytes()) or b"")
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); was it created by robustflow prepare?") from error
    except ValidationError as error:
        raise DataError(path, "not written by robustflow prepare, or damaged; prepare the clips again") from error
    if manifest.version != VERSION:
        raise DataError(path, "written by a different version of RobustFlow; prepare the clips again")
    return manifest
