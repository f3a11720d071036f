"""The released KITTI-FC and GoPro-FC: clean pairs, and their corrupted frames in a folder per corruption and severity.

clean/val/image_2/000003_10.png  000003_11.png       clean/val/flow_occ/000003_10.png     (the same under training/)
fog_3/val/image_2/000003_10.png  000003_11.png

clean/GOPR0374_11_02/000032_0.png  000032_1.png      fog_3/GOPR0374_11_02/000032_0.png  000032_1.png
"""

from __future__ import annotations

import re
from pathlib import Path

from ...core.errors import DataError
from ...core.paths import folders
from ...core.types import Frame
from .dataset import FC_PAPER, DatasetFacts
from .kitti import KittiPairs
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles, read_frames
from .places import locate, partner

DISK_NAMES = {"high_light": "brightness"}
"""Corruptions whose folder names differ from the paper's names."""


class ReleasedPairs(LayoutDataset):
    """Pairs distributed with their corrupted frames. Implements `PreCorrupted`; `root` contains `clean/` and the
    folders of corrupted frames."""

    root: Path

    def has_corrupted(self, corruption: str) -> bool:
        return bool(self.severities(corruption))

    def severities(self, corruption: str) -> tuple[int, ...]:
        """Return the available severities of a corruption, ascending."""
        pattern = re.escape(DISK_NAMES.get(corruption, corruption)) + r"_([1-5])"
        matches = (re.fullmatch(pattern, folder.name) for folder in folders(self.root))
        return tuple(sorted(int(match[1]) for match in matches if match))

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        setting = self.root / f"{DISK_NAMES.get(corruption, corruption)}_{severity}"
        if not setting.is_dir():
            available = ", ".join(map(str, self.severities(corruption))) or "none"
            raise DataError(setting, f"no such folder; severities of {corruption} in this release: {available}")
        clean = self.root / "clean"
        return [partner(setting / frame.relative_to(clean), frame) for frame in self.pair(key).frames]

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        paths = self.corrupted_files(key, corruption, severity)
        return read_frames((self.pair(key).frames[0], *paths))[1:]


class KittiFCReleased(ReleasedPairs, KittiPairs):
    """The released KITTI-FC: clean samples and their corrupted frames. Implements `PreCorrupted`."""

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
    options = {"split": ("val", "training")}

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        self.root = locate(self.facts.title, root, [f"clean/{words['split']}/image_2"], expected=self.facts.layout)
        return super().find(self.root / "clean" / words["split"], words)


class GoProFCReleased(ReleasedPairs):
    """The released GoPro-FC: clean pairs and their corrupted frames. Implements `PreCorrupted`."""

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
    layout = Layout("clean/{sequence}/{pair}_{n}.png", "", "{sequence}/{pair}", "{sequence}", first=0)
    marker = "clean"

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        self.root, pairs = super().find(root, words)
        return self.root, pairs
