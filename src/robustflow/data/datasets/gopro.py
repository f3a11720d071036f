"""GoPro, without flow, in two layouts.

test/GOPR0384_11_00/sharp/000001.png ...    (GoPro_Large: blur, blur_gamma, sharp)
test/GOPR0384_11_00/000001.png ...          (GoPro_Large_all: the camera's 240 frames per second)
"""

from __future__ import annotations

from pathlib import Path

from ...core.arguments import check_count, choice
from ...core.errors import DataError
from ...core.paths import folders, user_path
from .dataset import DatasetFacts
from .layout import matching
from .pair_files import PairDataset, PairFiles, pairs_at_step
from .places import consecutive, locate

_KINDS = ("sharp", "blur", "blur_gamma")


class GoPro(PairDataset):
    """The GoPro dataset. `root` contains `train/` and `test/`, or the sequences themselves."""

    name = "gopro"
    has_flow = False
    facts = DatasetFacts(
        title="GoPro",
        description="33 hand-held sequences, 720x1280, recorded at 240 frames per second.",
        ground_truth="none",
        clips="always",
        licence="CC BY 4.0",
        citation="Nah, Kim and Lee, Deep Multi-scale CNN for Dynamic Scene Deblurring, CVPR 2017",
        layout="train/GOPR0372_07_00/sharp, test/..., or folders of frames",
        training_set="gopro",
    )

    def __init__(self, root: str | Path, split: str = "all", images: str = "sharp", step: int = 1) -> None:
        choice("split", split, ("all", "train", "test"))
        choice("images", images, _KINDS)
        check_count("step", step)
        root = user_path(root)
        pairs: dict[str, PairFiles] = {}
        for sequence in _sequences(root, split):
            group = sequence.relative_to(root).as_posix()
            for first, second in pairs_at_step(_frames(sequence, images), step, sequence):
                pairs[f"{group}/{first.stem}"] = PairFiles((first, second), group=group)
        super().__init__(pairs, root)


def _sequences(root: Path, split: str) -> list[Path]:
    parts = ("train", "test") if split == "all" else (split,)
    if sequences := [folder for part in parts for folder in folders(root / part)]:
        return sequences
    plain = [folder for folder in folders(root) if _is_sequence(folder)]
    if plain and split == "all":
        return plain
    if root.is_dir() and _is_sequence(root):
        raise DataError(root, "a single sequence; give its parent folder, or read it as dataset 'folder'")
    return folders(locate(GoPro.facts.title, root, parts, expected=GoPro.facts.layout))


def _is_sequence(folder: Path) -> bool:
    return any((folder / kind).is_dir() for kind in _KINDS) or bool(matching(folder, "{n}.png"))


def _frames(sequence: Path, images: str) -> list[Path]:
    kinds = [kind for kind in _KINDS if (sequence / kind).is_dir()]
    if kinds and images not in kinds:
        raise DataError(sequence / images, f"no such folder; choose images from {', '.join(kinds)}")
    frames = matching(sequence / images if kinds else sequence, "{n}.png").get((), {})
    consecutive(frames, stride=None)
    return list(frames.values())
