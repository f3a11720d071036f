"""GoPro-FC as released: pairs of key frames, one folder per corruption and severity, read as they are.

clean/GOPR0374_11_02/000032_0.png  000032_1.png        fog_3/GOPR0374_11_02/000032_0.png  000032_1.png
"""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import DataError
from ..sample import Frame
from .kitti_fc import DISK_NAMES
from .layout import folders, locate, numbered, partner
from .pairs import Pair, PairDataset, read_frames


class GoProFCReleased(PairDataset):
    """The released benchmark: clean pairs, and the corrupted frames of each. Implements `PreCorrupted`.

    Args:
        root: the folder that holds `clean/` and the corruptions.

    Raises:
        DataError: another layout, or a frame of a clean pair is missing.
    """

    name = "gopro_fc_released"
    has_flow = False

    def __init__(self, root: str | Path) -> None:
        self.root = locate(
            "GoPro-FC", root, ["clean"], expected="clean/SEQUENCE/000032_0.png and <corruption>_<severity>/"
        )
        pairs: dict[str, Pair] = {}
        for sequence in folders(self.root / "clean"):
            for first in numbered(sequence, r"(\d{1,9})_0\.png").values():
                second = partner(first.with_name(f"{first.stem[:-1]}1.png"), first)
                pairs[f"{sequence.name}/{first.stem[:-2]}"] = Pair((first, second), group=sequence.name)
        super().__init__(pairs, self.root)

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
        pair = self.pair(key)
        return [partner(setting / pair.group / frame.name, frame) for frame in pair.frames]

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """See `PreCorrupted.corrupted`."""
        paths = self.corrupted_files(key, corruption, severity)
        return read_frames((self.pair(key).frames[0], *paths))[1:]
