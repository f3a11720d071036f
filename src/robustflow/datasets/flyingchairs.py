"""FlyingChairs: 22,872 synthetic pairs with dense ground truth.

    data/00001_img1.ppm  00001_img2.ppm  00001_flow.flo
    FlyingChairs_train_val.txt (or chairs_split.txt), next to or in data/: line i is 1 (train) or 2 (val) for pair i

Source: Dosovitskiy et al., ICCV 2015.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import DataError
from ..layout import choice, locate, numbered, partner, user_path
from .facts import NON_COMMERCIAL, DatasetFacts
from .pairs import PairDataset, PairFiles

_SUFFIXES = {"img1": "ppm", "img2": "ppm", "flow": "flo"}
_SPLIT_FILES = ("FlyingChairs_train_val.txt", "chairs_split.txt")


class FlyingChairs(PairDataset):
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

    def __init__(self, root: str | Path, split: str = "all") -> None:
        choice("split", split, ("all", "train", "val"))
        folder = _data(user_path(root))
        files = {kind: numbered(folder, rf"(\d{{5}})_{kind}\.{suffix}") for kind, suffix in _SUFFIXES.items()}
        numbers = sorted(set().union(*files.values()))
        for number in numbers:
            whose = next(of_kind[number] for of_kind in files.values() if number in of_kind)
            for kind, suffix in _SUFFIXES.items():
                if number not in files[kind]:
                    partner(folder / f"{number:05d}_{kind}.{suffix}", whose)
        if split != "all" and numbers:
            marks = _marks(folder, numbers)
            numbers = [number for number in numbers if marks[number - 1] == {"train": "1", "val": "2"}[split]]
        pairs = {f"{n:05d}": PairFiles((files["img1"][n], files["img2"][n]), files["flow"][n]) for n in numbers}
        super().__init__(pairs, folder)


def _data(root: Path) -> Path:
    if root.is_dir() and next(root.glob("*_img1.ppm"), None) is not None:
        return root
    return locate("FlyingChairs", root, ["data"], expected="data/00001_img1.ppm, _img2.ppm and _flow.flo") / "data"


def _marks(folder: Path, numbers: list[int]) -> list[str]:
    places = (parent / name for parent in (folder, folder.parent) for name in _SPLIT_FILES)
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise DataError(
            f"{folder}: no {' or '.join(_SPLIT_FILES)} here or in the parent folder; add one, or use split 'all'"
        )
    marks = path.read_text(errors="replace").split()
    if not set(marks) <= {"1", "2"} or len(marks) < max(numbers):
        raise DataError(f"{path}: expected a 1 (train) or 2 (val) for each of at least {max(numbers)} pairs")
    return marks
