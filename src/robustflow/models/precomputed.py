"""Read precomputed flows from files, one flow per sample and condition."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..core.errors import ModelError
from ..core.files import sha256_of_file
from ..core.paths import refuse_backslashes, user_path
from ..core.text import first_of, plain
from ..core.types import Flow
from ..media.flow import FLOW_SUFFIXES, read_flow

_ADDITIONS = re.compile(
    r"^(?:(?:flow|flo|pred|prediction|frame|fw|left)(?:[_-]|(?=\d)))+|(?:[_-](?:10|flow|flo|pred|prediction))+$", re.I
)
"""What other programs add to the name of a sample: 000000_10 (KITTI), flow_000000, frame0001 instead of frame_0001."""
_NAMED = 3
"""Maximum number of existing files that an error names."""


class Precomputed:
    """A model that reads its flows from a folder with the layout of the released benchmark: `clean/<key>.<ext>` and
    `<corruption>_<severity>/<key>.<ext>`, where ext is flo, png (KITTI 16-bit), pfm, flo5 or npy. File names that other
    programs make of a key are understood too, such as `<key>_10`, `flow_<key>` and `<key>_flow`.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = user_path(folder)
        if not (self._folder / "clean").is_dir():
            refuse_backslashes(self._folder)
            raise ModelError(
                self._folder, f"no folder 'clean' with flow files; expected clean/<key>.flo{_contents(self._folder)}"
            )
        self._listed: dict[Path, dict[str, list[Path]]] = {}

    def identity(self) -> dict[str, Any]:
        """Return a hash of all files' names and contents, so that different flows count as different models regardless
        of where they are stored. File sizes would not be sufficient, because they depend only on the frame sizes.
        """
        listing = hashlib.sha256()
        for path in sorted(_flow_files(self._folder)):
            name = path.relative_to(self._folder).as_posix()
            listing.update(f"{name} {_sha256(path)}\n".encode(errors="surrogateescape"))
        return {"name": "precomputed", "files": listing.hexdigest()}

    def lookup(self, key: str, corruption: str, severity: int) -> Flow:
        """Read a flow as described in `FlowLookup.lookup`. Pixels that a file marks as unknown are NaN."""
        setting = f"{corruption}_{severity}" if severity else corruption
        flow, valid = read_flow(self._path(self._folder / setting, PurePosixPath(key)))
        return flow if valid.all() else np.where(valid[..., None], flow, np.float32(np.nan))

    def _path(self, folder: Path, key: PurePosixPath) -> Path:
        """Return the file of a key: of the same name or, if there is none, the only one that differs by additions."""
        for suffix in FLOW_SUFFIXES:
            if (path := folder / f"{key}{suffix}").is_file():
                return path
        parent = folder / key.parent
        if parent not in self._listed:
            self._listed[parent] = _by_name(parent)
        paths = self._listed[parent].get(_ADDITIONS.sub("", key.name), [])
        if len({path.stem for path in paths}) == 1:
            return paths[0]
        name = f"{folder.name}/{key}"
        if paths:
            several = first_of([path.name for path in paths], _NAMED)
            raise ModelError(self._folder, f"{several} may be {name}; name the right one {key.name}{paths[0].suffix}")
        place = next(place for place in (folder / key, parent, folder, self._folder) if place.is_dir())
        formats = ", ".join(FLOW_SUFFIXES)
        raise ModelError(self._folder, f"no {name} with the suffix {formats}{_contents(place, self._folder)}")


def _by_name(folder: Path) -> dict[str, list[Path]]:
    """Return the flow files of a folder by name without additions, each list in the order of the formats."""
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.suffix in FLOW_SUFFIXES and path.is_file():
            files.setdefault(_ADDITIONS.sub("", path.stem), []).append(path)
    return {name: sorted(paths, key=lambda path: FLOW_SUFFIXES.index(path.suffix)) for name, paths in files.items()}


def _contents(folder: Path, root: Path | None = None) -> str:
    """Return the end of an error that names what a folder contains instead."""
    names = sorted(path.relative_to(root or folder).as_posix() for path in folder.iterdir()) if folder.is_dir() else []
    return f"; there is {plain(first_of(names, _NAMED), 200)}" if names else ""


def _flow_files(folder: Path) -> Iterator[Path]:
    """Yield the flow files in the subfolders; links are followed, except back to a folder that was read before."""
    read: set[str] = set()
    for place, folders, names in os.walk(folder, followlinks=True):
        read.add(os.path.realpath(place))
        folders[:] = [name for name in sorted(folders) if os.path.realpath(os.path.join(place, name)) not in read]
        for path in (Path(place, name) for name in names):
            if path.suffix in FLOW_SUFFIXES and path.parent != folder and path.is_file():
                yield path


def _sha256(path: Path) -> str:
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise ModelError(path, f"cannot be read ({error.strerror or error}); check its permissions") from None
