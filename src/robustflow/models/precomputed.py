"""Read precomputed flows from files, one flow per sample and condition."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ModelError
from ..core.files import sha256_of_file
from ..core.paths import user_path
from ..core.types import Flow
from ..media.flow import FLOW_SUFFIXES, read_flow


class Precomputed:
    """A model that reads its flows from a folder with the layout of the released benchmark: `clean/<key>.<ext>` and
    `<corruption>_<severity>/<key>.<ext>`, where ext is flo, png (KITTI 16-bit), pfm or flo5.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = user_path(folder)
        if not (self._folder / "clean").is_dir():
            raise ModelError(self._folder, "no folder 'clean' with flow files; expected clean/<key>.flo")

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
        for suffix in FLOW_SUFFIXES:
            path = self._folder / setting / f"{key}{suffix}"
            if path.is_file():
                flow, valid = read_flow(path)
                return flow if valid.all() else np.where(valid[..., None], flow, np.float32(np.nan))
        raise ModelError(self._folder, f"no {setting}/{key} with the suffix {', '.join(FLOW_SUFFIXES)}")


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
