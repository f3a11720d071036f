"""The released GoPro-FC: pairs of key frames, one folder per corruption and severity, read unchanged.

clean/GOPR0374_11_02/000032_0.png  000032_1.png        fog_3/GOPR0374_11_02/000032_0.png  000032_1.png
"""

from __future__ import annotations

from pathlib import Path

from ..layout import folders, locate, numbered, partner
from .facts import FC_PAPER, DatasetFacts
from .pairs import PairFiles
from .released import ReleasedPairs


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
