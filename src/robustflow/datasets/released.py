"""Common parts of the two released benchmarks: clean pairs, and a folder `<corruption>_<severity>` per condition."""

from __future__ import annotations

import re
from abc import abstractmethod
from pathlib import Path

from ..errors import DataError
from ..layout import folders, partner
from ..sample import Frame
from .pairs import PairDataset, read_frames

DISK_NAMES = {"high_light": "brightness"}
"""Corruptions whose folder names differ from the paper's names."""


class ReleasedPairs(PairDataset):
    """Pairs distributed with their corrupted frames. Implements `PreCorrupted`; `root` contains `clean/` and the
    folders of corrupted frames."""

    root: Path

    @abstractmethod
    def place(self, key: str) -> Path:
        """Return the folder of a pair's frames, relative to the folder of a corruption and severity."""

    def has_corrupted(self, corruption: str) -> bool:
        """See `PreCorrupted.has_corrupted`."""
        return bool(self.severities(corruption))

    def severities(self, corruption: str) -> tuple[int, ...]:
        """Return the available severities of a corruption, ascending."""
        pattern = re.escape(DISK_NAMES.get(corruption, corruption)) + r"_([1-5])"
        matches = (re.fullmatch(pattern, folder.name) for folder in folders(self.root))
        return tuple(sorted(int(match[1]) for match in matches if match))

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        """See `PreCorrupted.corrupted_files`."""
        setting = self.root / f"{DISK_NAMES.get(corruption, corruption)}_{severity}"
        if not setting.is_dir():
            known = ", ".join(map(str, self.severities(corruption))) or "none"
            raise DataError(f"{setting}: no such folder; severities of {corruption} in this release: {known}")
        return [partner(setting / self.place(key) / frame.name, frame) for frame in self.pair(key).frames]

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """See `PreCorrupted.corrupted`."""
        paths = self.corrupted_files(key, corruption, severity)
        return read_frames((self.pair(key).frames[0], *paths))[1:]
