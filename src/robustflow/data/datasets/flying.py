"""FlyingChairs: 22,872 synthetic pairs with dense ground truth. FlyingThings3D: 2,239 training and 437 test scenes
of ten frames, dense ground truth in .pfm.

    data/00001_img1.ppm  00001_img2.ppm  00001_flow.flo
    FlyingChairs_train_val.txt (or chairs_split.txt), next to or in data/: line i is 1 (train) or 2 (val) for pair i

Source: Dosovitskiy et al., ICCV 2015.

    frames_cleanpass/TRAIN/A/0000/left/0006.png ...     (frames_finalpass; .webp in the smaller download)
    optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture_0006_L.pfm ...

Or the authors' subset for optical flow, without the most extreme scenes:

    train/image_clean/left/0000000.png ...          (or image_final; val for the test scenes)
    train/flow/left/into_future/0000000.flo ...     none for the last frame of a scene

Source: Mayer et al., CVPR 2016.
"""

from __future__ import annotations

from pathlib import Path

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import consecutive, folders, locate, numbered, partner, user_path
from .base import NON_COMMERCIAL, DatasetFacts
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
            folder, f"no {' or '.join(_SPLIT_FILES)} here or in the parent folder; add one, or use split 'all'"
        )
    marks = path.read_text(errors="replace").split()
    if not set(marks) <= {"1", "2"} or len(marks) < max(numbers):
        raise DataError(path, f"expected a 1 (train) or 2 (val) for each of at least {max(numbers)} pairs")
    return marks


class FlyingThings3D(PairDataset):
    """The FlyingThings3D dataset. `root` contains `frames_cleanpass/` or `frames_finalpass/`, and `optical_flow/`; or
    `train/` and `val/` of the subset.
    """

    name = "flyingthings3d"
    facts = DatasetFacts(
        title="FlyingThings3D",
        description="2,239 training and 437 test scenes of ten synthetic frames, 540x960.",
        pairs=20151,
        clips="always",
        licence=NON_COMMERCIAL,
        citation="Mayer et al., A Large Dataset to Train Convolutional Networks for Disparity, Optical Flow, and Scene "
        "Flow Estimation, CVPR 2016",
        layout="frames_cleanpass/TRAIN, optical_flow/TRAIN",
        training_set="flyingthings3d",
    )

    def __init__(
        self,
        root: str | Path,
        render_pass: str = "clean",
        split: str = "TRAIN",
        side: str = "left",
        direction: str = "future",
    ) -> None:
        choice("render_pass", render_pass, ("clean", "final"))
        choice("split", split, ("TRAIN", "TEST"))
        choice("side", side, ("left", "right"))
        choice("direction", direction, ("future", "past"))
        images = f"frames_{render_pass}pass/{split}"
        part = user_path(root) / {"TRAIN": "train", "TEST": "val"}[split]
        if (part / f"image_{render_pass}").is_dir():
            super().__init__(_subset(part, render_pass, side, direction), part)
            return
        subset = f"of the subset {part.name}/image_{render_pass}/ and {part.name}/flow/"
        expected = f"{images}/A/0000/ and optical_flow/{split}/, or {subset}"
        folder = locate("FlyingThings3D", root, [images], expected=expected)
        pairs: dict[str, PairFiles] = {}
        for letter in folders(folder / images):
            for scene in folders(letter):
                group = f"{split}/{letter.name}/{scene.name}"
                flows = folder / "optical_flow" / group / f"into_{direction}" / side
                pairs.update(_scene(scene / side, flows, group, side, direction))
        super().__init__(pairs, folder)


def _scene(images: Path, flows: Path, group: str, side: str, direction: str) -> dict[str, PairFiles]:
    frames = numbered(images, r"(\d{4})\.(?:png|webp)")
    pairs = {}
    for before, after in consecutive(frames):
        first, second = (before, after) if direction == "future" else (after, before)
        name = f"OpticalFlowInto{direction.capitalize()}_{first:04d}_{side[0].upper()}.pfm"
        flow = partner(flows / name, frames[first])
        pairs[f"{group}/{first:04d}"] = PairFiles((frames[first], frames[second]), flow, group=group)
    return pairs


def _subset(part: Path, render_pass: str, side: str, direction: str) -> dict[str, PairFiles]:
    images, flows = part / f"image_{render_pass}" / side, part / "flow" / side / f"into_{direction}"
    for needed in (images, flows):
        if not needed.is_dir():
            raise DataError(needed, "no such folder; unpack that part of the FlyingThings3D subset there")
    ahead = 1 if direction == "future" else -1
    pairs, known, scene = {}, numbered(flows, r"(\d{7})\.flo"), 0
    for number, flow in known.items():
        first, second = (partner(images / f"{one:07d}.png", flow) for one in (number, number + ahead))
        scene = scene if number - 1 in known else number  # a scene ends with a frame without flow
        pairs[f"{part.name}/{number:07d}"] = PairFiles((first, second), flow, group=f"{part.name}/{scene:07d}")
    return pairs
