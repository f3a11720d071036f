"""FlyingThings3D, and its subset without the most extreme scenes, which has no flow for the last frame of a scene."""

from __future__ import annotations

from pathlib import Path

from ...core.errors import DataError
from .dataset import NON_COMMERCIAL, DatasetFacts
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles
from .places import locate


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
