"""KITTI-FC as released: KITTI 2015 already corrupted, one folder per corruption and severity.

clean/val/image_2/000003_10.png  000003_11.png       clean/val/flow_occ/000003_10.png
fog_3/val/image_2/000003_10.png  000003_11.png       (the same under training/)
"""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import DataError
from ..sample import Frame
from .kitti import KittiPairs, kitti_pairs
from .layout import choice, folders, locate, partner
from .pairs import read_frames

DISK_NAMES = {"high_light": "brightness"}
"""Corruptions whose folders carry another name than the paper's."""


class KittiFC(KittiPairs):
    """The released benchmark: clean samples, and the corrupted frames of each. Implements `PreCorrupted`.

    Args:
        root: the folder that holds `clean/` and the corruptions.
        split: "val" (80 pairs, what the paper evaluates) or "training" (120).

    Raises:
        DataError: another layout, or a file of a clean pair is missing.
    """

    name = "kitti_fc"

    def __init__(self, root: str | Path, split: str = "val") -> None:
        choice("split", split, ("val", "training"))
        marker = f"clean/{split}/image_2"
        self.root = locate("KITTI-FC", root, [marker], expected=f"{marker}/ and <corruption>_<severity>/{split}/")
        self._split = split
        super().__init__(kitti_pairs(self.root / "clean" / split, "image_2"), self.root)

    def has_corrupted(self, corruption: str) -> bool:
        """See `PreCorrupted.has_corrupted`."""
        return bool(self.severities(corruption))

    def severities(self, corruption: str) -> tuple[int, ...]:
        """The severities there are of a corruption, ascending."""
        pattern = re.escape(DISK_NAMES.get(corruption, corruption)) + r"_([1-5])"
        matches = (re.fullmatch(pattern, folder.name) for folder in folders(self.root))
        return tuple(sorted(int(match[1]) for match in matches if match))

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        """See `PreCorrupted.corrupted_files`."""
        setting = self.root / f"{DISK_NAMES.get(corruption, corruption)}_{severity}"
        if not setting.is_dir():
            known = ", ".join(map(str, self.severities(corruption))) or "none"
            raise DataError(f"{setting}: no such folder; severities of {corruption} in this release: {known}")
        clean = self.pair(key).frames
        return [partner(setting / self._split / "image_2" / frame.name, frame) for frame in clean]

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """See `PreCorrupted.corrupted`."""
        paths = self.corrupted_files(key, corruption, severity)
        frames = read_frames((self.pair(key).frames[0], *paths))
        return frames[1:]
