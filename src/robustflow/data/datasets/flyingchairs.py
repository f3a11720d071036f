"""FlyingChairs. Line i of FlyingChairs_train_val.txt (or chairs_split.txt), in data/ or beside it, is 1 (train) or 2
(val) for pair i.
"""

from __future__ import annotations

from pathlib import Path

from ...core.errors import DataError
from .dataset import NON_COMMERCIAL, DatasetFacts
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles
from .places import locate

_SPLIT_FILES = ("FlyingChairs_train_val.txt", "chairs_split.txt")


class FlyingChairs(LayoutDataset):
    """The FlyingChairs dataset. `root` is `data/` or its parent folder."""

    name = "flyingchairs"
    facts = DatasetFacts(
        title="FlyingChairs",
        description="Synthetic pairs of chairs moving over photographs, 384x512.",
        pairs=22872,
        licence=NON_COMMERCIAL,
        citation="Dosovitskiy et al., FlowNet: Learning Optical Flow with Convolutional Networks, ICCV 2015",
        layout="data/00001_img1.ppm, data/00001_img2.ppm, data/00001_flow.flo",
        training_set="flyingchairs",
    )
    layout = Layout("{pair:05}_img{n}.ppm", "{pair:05}_flow.flo", "{pair}", first=1)
    options = {"split": ("all", "train", "val")}

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        here = root.is_dir() and any(root.glob("*_img1.ppm"))
        folder = root if here else locate(self.facts.title, root, ["data"], expected=self.facts.layout) / "data"
        pairs = self.layout.pairs(folder)
        if words["split"] == "all" or not pairs:
            return folder, pairs
        marks, wanted = _marks(folder, int(max(pairs))), {"train": "1", "val": "2"}[words["split"]]
        return folder, {key: pair for key, pair in pairs.items() if marks[int(key) - 1] == wanted}


def _marks(folder: Path, count: int) -> list[str]:
    places = (parent / name for parent in (folder, folder.parent) for name in _SPLIT_FILES)
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise DataError(folder, f"no {' or '.join(_SPLIT_FILES)} here or in the parent folder; add one, or omit split")
    marks = path.read_text(errors="replace").split()
    if not set(marks) <= {"1", "2"} or len(marks) < count:
        raise DataError(path, f"expected a 1 (train) or 2 (val) for each of at least {count} pairs")
    return marks
