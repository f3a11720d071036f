"""Common parts of the two released benchmarks: clean pairs, and a folder `<corruption>_<severity>` per condition.
The released KITTI-FC: corrupted frames of KITTI 2015, one folder per corruption and severity. The released
GoPro-FC: pairs of key frames, one folder per corruption and severity, read unchanged.

clean/val/image_2/000003_10.png  000003_11.png       clean/val/flow_occ/000003_10.png
fog_3/val/image_2/000003_10.png  000003_11.png       (the same under training/)

clean/GOPR0374_11_02/000032_0.png  000032_1.png        fog_3/GOPR0374_11_02/000032_0.png  000032_1.png
"""

from __future__ import annotations

import re
from abc import abstractmethod
from pathlib import Path

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import folders, locate, numbered, partner
from ...core.types import Frame
from .base import FC_PAPER, DatasetFacts
from .kitti import KittiPairs, kitti_pairs
from .pairs import PairDataset, PairFiles, read_frames

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
            raise DataError(setting, f"no such folder; severities of {corruption} in this release: {known}")
        return [partner(setting / self.place(key) / frame.name, frame) for frame in self.pair(key).frames]

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """See `PreCorrupted.corrupted`."""
        paths = self.corrupted_files(key, corruption, severity)
        return read_frames((self.pair(key).frames[0], *paths))[1:]


class KittiFCReleased(KittiPairs, ReleasedPairs):
    """The released benchmark: clean samples and their corrupted frames. Implements `PreCorrupted`."""

    name = "kitti_fc_released"
    facts = DatasetFacts(
        title="KITTI-FC, released files",
        description="KITTI 2015, released with every corruption applied: 80 pairs in val, 120 in training.",
        ground_truth="sparse",
        pairs=80,
        licence="CC BY-NC-SA 3.0 (derived from KITTI)",
        citation=f"{FC_PAPER}; Menze and Geiger, CVPR 2015",
        layout="clean/val/image_2, clean/val/flow_occ, fog_3/val/image_2",
        training_set="kitti2015",
        same_domain=("kitti2012", "kitti-raw"),
        benchmark="kitti-fc",
    )

    def __init__(self, root: str | Path, split: str = "val") -> None:
        choice("split", split, ("val", "training"))
        marker = f"clean/{split}/image_2"
        self.root = locate("KITTI-FC", root, [marker], expected=f"{marker}/ and <corruption>_<severity>/{split}/")
        self._split = split
        clean = self.root / "clean" / split
        super().__init__(kitti_pairs(clean, "image_2", self.name), clean)

    def place(self, key: str) -> Path:
        """See `ReleasedPairs.place`."""
        return Path(self._split) / "image_2"


class GoProFCReleased(ReleasedPairs):
    """The released benchmark: clean pairs and their corrupted frames. Implements `PreCorrupted`."""

    name = "gopro_fc_released"
    has_flow = False
    facts = DatasetFacts(
        title="GoPro-FC, released files",
        description="Pairs of key frames from five GoPro sequences, released with every corruption applied.",
        ground_truth="none",
        licence="CC BY 4.0 (derived from GoPro)",
        citation=f"{FC_PAPER}; Nah, Kim and Lee, CVPR 2017",
        layout="clean/GOPR0374_11_02, fog_3/GOPR0374_11_02",
        training_set="gopro",
        benchmark="gopro-fc",
    )

    def __init__(self, root: str | Path) -> None:
        self.root = locate(
            "GoPro-FC", root, ["clean"], expected="clean/SEQUENCE/000032_0.png and <corruption>_<severity>/"
        )
        pairs: dict[str, PairFiles] = {}
        for sequence in folders(self.root / "clean"):
            for first in numbered(sequence, r"(\d{1,9})_0\.png").values():
                second = partner(first.with_name(f"{first.stem[:-1]}1.png"), first)
                pairs[f"{sequence.name}/{first.stem[:-2]}"] = PairFiles((first, second), group=sequence.name)
        super().__init__(pairs, self.root)

    def place(self, key: str) -> Path:
        """See `ReleasedPairs.place`."""
        return Path(self.pair(key).group)
