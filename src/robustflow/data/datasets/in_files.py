"""Datasets of frames and flow in files: FlyingChairs, FlyingThings3D, HD1K, Middlebury and GoPro.

FlyingChairs_train_val.txt (or chairs_split.txt), in data/ or beside it: line i is 1 (train) or 2 (val) for pair i.
FlyingThings3D's subset without the most extreme scenes has no flow for the last frame of a scene; HD1K has flow for
every frame. Middlebury's Beanbags, DogDance, MiniCooper and Walking have no flow. GoPro has no flow, and two layouts:

    test/GOPR0384_11_00/sharp/000001.png ...    (GoPro_Large: blur, blur_gamma, sharp)
    test/GOPR0384_11_00/000001.png ...          (GOPRO_Large_all: the camera's 240 frames per second)
"""

from __future__ import annotations

from pathlib import Path

from ...core.arguments import check_count, choice
from ...core.errors import DataError
from ...core.paths import consecutive, folders, locate, user_path
from .base import NON_COMMERCIAL, DatasetFacts
from .layout import Layout, LayoutDataset, matching
from .pairs import PairDataset, PairFiles, pairs_at_step

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


class FlyingThings3D(LayoutDataset):
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
    layout = Layout(
        "frames_{render_pass}pass/{split}/{letter}/{scene}/{side}/{n:04}.{type}",
        "optical_flow/{split}/{letter}/{scene}/into_{direction}/{side}/OpticalFlowInto{Direction}_{n:04}_{SIDE}.pfm",
        "{split}/{letter}/{scene}/{n:04}",
        "{split}/{letter}/{scene}",
        flow_needs=(),
    )
    subset = Layout(
        "image_{render_pass}/{side}/{n:07}.png",
        "flow/{side}/into_{direction}/{n:07}.flo",
        "{part}/{n:07}",
        by_flow=True,
    )
    options = {
        "render_pass": ("clean", "final"),
        "split": ("TRAIN", "TEST"),
        "side": ("left", "right"),
        "direction": ("future", "past"),
    }

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        part = root / {"TRAIN": "train", "TEST": "val"}[words["split"]]
        images, side, direction = f"image_{words['render_pass']}", words["side"], words["direction"]
        if (part / images).is_dir():
            for needed in (part / images / side, part / "flow" / side / f"into_{direction}"):
                if not needed.is_dir():
                    raise DataError(needed, "no such folder; unpack that part of the FlyingThings3D subset there")
            return part, _in_scenes(self.subset.pairs(part, part=part.name, **words), part.name)
        frames = f"frames_{words['render_pass']}pass/{words['split']}"
        expected = f"{frames}/A/0000/ and optical_flow/{words['split']}/, or {part.name}/{images}/ of the subset"
        folder = locate(self.facts.title, root, [frames], expected=expected)
        webp = next((folder / frames).glob(f"*/*/{side}/*.webp"), None)
        words |= {"Direction": direction.capitalize(), "SIDE": side[0].upper(), "type": "webp" if webp else "png"}
        return folder, self.layout.pairs(folder, **words)


def _in_scenes(pairs: dict[str, PairFiles], part: str) -> dict[str, PairFiles]:
    """Return the pairs of the subset by scene: a scene ends with a frame without flow."""
    grouped, scene, last = {}, 0, -2
    for key, pair in sorted(pairs.items()):
        number = int(key.rpartition("/")[2])
        scene = scene if number == last + 1 else number
        grouped[key] = PairFiles(pair.frames, pair.flow, group=f"{part}/{scene:07d}")
        last = number
    return grouped


class HD1K(LayoutDataset):
    """The HD1K dataset. `root` contains `hd1k_input/` and `hd1k_flow_gt/`."""

    name = "hd1k"
    facts = DatasetFacts(
        title="HD1K",
        description="36 driving sequences, 1080x2560.",
        ground_truth="sparse",
        pairs=1047,
        clips="always",
        licence=NON_COMMERCIAL,
        citation="Kondermann et al., The HCI Benchmark Suite, CVPR Workshops 2016",
        layout="hd1k_input/image_2, hd1k_flow_gt/flow_occ",
        training_set="hd1k",
    )
    layout = Layout(
        "hd1k_input/image_2/{sequence:06}_{n:04}.png",
        "hd1k_flow_gt/flow_occ/{sequence:06}_{n:04}.png",
        group="{sequence}",
        stride=None,
        flow_needs=(0,),
    )


class Middlebury(LayoutDataset):
    """The Middlebury dataset. `root` contains `other-data/` and `other-gt-flow/`."""

    name = "middlebury"
    facts = DatasetFacts(
        title="Middlebury optical flow",
        description="Small scenes, real and rendered.",
        pairs=8,
        clips="with all frames of a scene",
        licence=NON_COMMERCIAL,
        citation="Baker et al., A Database and Evaluation Methodology for Optical Flow, IJCV 2011",
        layout="other-data/SCENE/frame10.png, other-gt-flow/SCENE/flow10.flo",
        training_set="middlebury",
    )
    layout = Layout(
        "other-data/{scene}/frame{n:02}.png",
        "other-gt-flow/{scene}/flow{n:02}.flo",
        "{scene}",
        by_flow=True,
        more_frames=True,
    )
    marker = "other-gt-flow"


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
