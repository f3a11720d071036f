"""Spring: 37 training sequences of an animated film at 1080x1920, ground truth at 2160x3840. Needs the extra `h5`.

    train/0001/frame_left/frame_left_0001.png ...
    train/0001/flow_FW_left/flow_FW_left_0001.flo5 ...      from this frame to the next
    train/0001/flow_BW_left/flow_BW_left_0002.flo5 ...      from this frame to the previous one
    train/0001/disp1_left/disp1_left_0001.dsp5 ...          for depth: disparity, in pixels of the frames; 0 in
                                                            the sky, NaN where unknown
    train/0001/cam_data/intrinsics.txt                      for depth: fx fy cx cy of each frame

Vectors are in pixels of the frames, with four vectors per pixel; like the benchmark's own reader, this reader uses
every second vector in both directions. The optional maps (sky, detail, matching) are not read. Source: Mehl et al.,
CVPR 2023.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import consecutive, folders, locate, numbered, partner, user_path
from ...core.plugins import require
from ...core.types import Camera, Sample, SceneDepth
from ...media.depth import read_dsp5
from ...media.flow import read_flow
from .base import DatasetFacts
from .depth import SKY, check_size, depth_of, existing, scene_depth, table_of
from .motorcycle import with_motion
from .pairs import PairDataset, PairFiles, Truth

_BASELINE = 0.065
"""Stereo baseline, in metres."""


class Spring(PairDataset):
    """The Spring dataset. `root` is `train/` or its parent folder."""

    name = "spring"
    facts = DatasetFacts(
        title="Spring",
        description="37 sequences of an animated film, 1080x1920, with detailed ground truth.",
        pairs=4963,
        depth="disparity and intrinsics",
        clips="always",
        licence="CC BY 4.0",
        citation="Mehl et al., Spring: A High-Resolution High-Detail Dataset and Benchmark, CVPR 2023",
        layout="train/0001/frame_left, train/0001/flow_FW_left",
        training_set="spring",
    )

    def __init__(self, root: str | Path, side: str = "left", direction: str = "FW") -> None:
        choice("side", side, ("left", "right"))
        choice("direction", direction, ("FW", "BW"))
        require("h5py", "Spring's ground truth")
        expected = f"train/0001/frame_{side}/ and train/0001/flow_{direction}_{side}/"
        folder = _train(user_path(root), expected)
        pairs: dict[str, PairFiles] = {}
        for sequence in folders(folder):
            pairs.update(_sequence(sequence, side, direction))
        super().__init__(pairs, folder)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read every second vector of every second row."""
        if pair.flow is None:
            return None
        flow, valid = read_flow(pair.flow)
        if flow.shape[0] % 2 or flow.shape[1] % 2:
            raise DataError(
                pair.flow, f"{flow.shape[0]}x{flow.shape[1]} vectors; Spring has two per pixel on each axis"
            )
        return Truth(flow[::2, ::2].copy(), valid[::2, ::2].copy())

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. Depth is fx times 0.065 m / disparity, limited to 10 km; like the flow, it is
        taken at every second value. The camera motion is fitted to depth and true flow (`camera_motion`)."""
        *maps, intrinsics = self.depth_files(sample.key)
        table = table_of(intrinsics, 4)
        depths, lenses = [], []
        for path in maps:
            place = int(path.stem[-4:]) - 1
            if place >= len(table) or not (table[place, :2] > 0).all():
                raise DataError(intrinsics, f"no positive focal lengths for frame {place + 1}; restore the file")
            fx, fy, cx, cy = table[place].tolist()
            lenses.append((fx, fy, cx, cy))
            disparity = read_dsp5(path)[::2, ::2]
            disparity = np.where(disparity >= 0, np.maximum(disparity, fx * _BASELINE / SKY), disparity)
            depths.append(depth_of(disparity, fx * _BASELINE))
            check_size(depths[-1], sample.shape, f"{path}: every second value of the disparity")
        (fx, fy, cx, cy), second = lenses
        camera = Camera((fx, fy), (cx, cy), second=second)
        if sample.flow is not None and sample.valid is not None:
            camera = with_motion(camera, depths[0], sample.flow, sample.valid & (depths[0] > 0))
        return scene_depth(depths[0], depths[1], camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        """See `Depths.depth_files`."""
        frames = self.pair(key).frames
        sequence = frames[0].parent.parent
        names = [frame.stem.replace("frame_", "disp1_") for frame in frames]
        maps = [sequence / name.rpartition("_")[0] / f"{name}.dsp5" for name in names]
        files = [*maps, sequence / "cam_data" / "intrinsics.txt"]
        return existing(files, "Spring", "disp1_left/, disp1_right/ and cam_data/")

    def training_truth(self, pair: PairFiles) -> Truth | None:
        """See `PairDataset.training_truth`."""
        return self.truth(pair)


def _train(root: Path, expected: str) -> Path:
    if any((sequence / f"frame_{side}").is_dir() for sequence in folders(root) for side in ("left", "right")):
        return root
    return locate("Spring", root, ["train"], expected=expected) / "train"


def _sequence(sequence: Path, side: str, direction: str) -> dict[str, PairFiles]:
    images, flows = sequence / f"frame_{side}", sequence / f"flow_{direction}_{side}"
    ahead = 1 if direction == "FW" else -1
    known = numbered(flows, rf"flow_{direction}_{side}_(\d{{4}})\.flo5")
    for number, flow in known.items():
        for needed in (number, number + ahead):
            partner(images / f"frame_{side}_{needed:04d}.png", flow)
    frames = numbered(images, rf"frame_{side}_(\d{{4}})\.png")
    pairs = {}
    for before, after in consecutive(frames):
        first, second = (before, after) if ahead == 1 else (after, before)
        flow = partner(flows / f"flow_{direction}_{side}_{first:04d}.flo5", frames[first])
        pairs[f"{sequence.name}/{first:04d}"] = PairFiles((frames[first], frames[second]), flow, group=sequence.name)
    return pairs
