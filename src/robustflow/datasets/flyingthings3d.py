"""FlyingThings3D: 2,239 training and 437 test scenes of ten frames, dense ground truth in .pfm.

    frames_cleanpass/TRAIN/A/0000/left/0006.png ...     (frames_finalpass; .webp in the smaller download)
    optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture_0006_L.pfm ...

Or the authors' subset for optical flow, without the most extreme scenes:

    train/image_clean/left/0000000.png ...          (or image_final; val for the test scenes)
    train/flow/left/into_future/0000000.flo ...     none for the last frame of a scene

Source: Mayer et al., CVPR 2016.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import DataError
from ..layout import choice, consecutive, folders, locate, numbered, partner, user_path
from .facts import NON_COMMERCIAL, DatasetFacts
from .pairs import PairDataset, PairFiles


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
            raise DataError(f"{needed}: no such folder; unpack that part of the FlyingThings3D subset there")
    ahead = 1 if direction == "future" else -1
    pairs, known, scene = {}, numbered(flows, r"(\d{7})\.flo"), 0
    for number, flow in known.items():
        first, second = (partner(images / f"{one:07d}.png", flow) for one in (number, number + ahead))
        scene = scene if number - 1 in known else number  # a scene ends with a frame without flow
        pairs[f"{part.name}/{number:07d}"] = PairFiles((first, second), flow, group=f"{part.name}/{scene:07d}")
    return pairs
