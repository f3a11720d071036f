"""A model that exists only as files: one flow per sample and setting, computed elsewhere."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ModelError
from ..flowio import read_flow
from ..sample import Flow

_SUFFIXES = (".flo", ".png", ".pfm", ".flo5")


class Precomputed:
    """Flows from a folder laid out like the released benchmark:
    `clean/<key>.<ext>` and `<corruption>_<severity>/<key>.<ext>`, ext one of flo, png (KITTI 16-bit), pfm, flo5.

    A key with slashes (`alley_1/frame_0001`) is a path below the setting's folder.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder).expanduser()
        if not (self._folder / "clean").is_dir():
            raise ModelError(
                f"{self._folder}: no folder 'clean' with flow files; expected clean/<key>.flo and "
                "<corruption>_<severity>/<key>.flo"
            )

    def identity(self) -> dict[str, Any]:
        """Names and sizes of all files: another set of flows is another model, wherever it lies."""
        listing = hashlib.blake2b(digest_size=16)
        for path in sorted(self._folder.rglob("*")):
            if path.suffix in _SUFFIXES:
                listing.update(f"{path.relative_to(self._folder).as_posix()} {path.stat().st_size}\n".encode())
        return {"name": "precomputed", "files": listing.hexdigest()}

    def lookup(self, key: str, corruption: str, severity: int) -> Flow:
        """See `FlowLookup.lookup`. Pixels a file marks as unknown come back as NaN."""
        setting = f"{corruption}_{severity}" if severity else corruption
        for suffix in _SUFFIXES:
            path = self._folder / setting / f"{key}{suffix}"
            if path.is_file():
                flow, valid = read_flow(path)
                return flow if valid.all() else np.where(valid[..., None], flow, np.float32(np.nan))
        raise ModelError(
            f"{self._folder}: no flow for sample '{key}' under {setting}/ (looked for {', '.join(_SUFFIXES)})"
        )
