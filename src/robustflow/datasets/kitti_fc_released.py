"""The released KITTI-FC: corrupted frames of KITTI 2015, one folder per corruption and severity.

clean/val/image_2/000003_10.png  000003_11.png       clean/val/flow_occ/000003_10.png
fog_3/val/image_2/000003_10.png  000003_11.png       (the same under training/)
"""

from __future__ import annotations

from pathlib import Path

from ..layout import choice, locate
from .facts import FC_PAPER, DatasetFacts
from .kitti import KittiPairs, kitti_pairs
from .released import ReleasedPairs


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
