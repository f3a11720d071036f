"""Spring (needs the extra `h5`).

    train/0001/disp1_left/disp1_left_0001.dsp5      disparity, in pixels; 0 in the sky, NaN where unknown
    train/0001/cam_data/intrinsics.txt              fx fy cx cy of each frame

Spring stores four vectors per pixel; like the benchmark's own reader, this one takes every second vector in both
directions.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...core.errors import DataError
from ...core.plugins import require
from ...core.types import Camera, Sample, SceneDepth
from ...media.depth import read_dsp5
from ...media.flow import read_flow
from .dataset import DatasetFacts
from .depth import SKY, check_size, depth_of, existing, scene_depth, table_of, with_motion
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles, Truth

_BASELINE = 0.065
"""Stereo baseline of Spring, in metres."""


class Spring(LayoutDataset):
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
    layout = Layout(
        "{sequence}/frame_{side}/frame_{side}_{n:04}.png",
        "{sequence}/flow_{direction}_{side}/flow_{direction}_{side}_{n:04}.flo5",
        "{sequence}/{n:04}",
        "{sequence}",
    )
    options = {"side": ("left", "right"), "direction": ("FW", "BW")}
    roots = ("", "train")

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        require("h5py", "Spring's ground truth")
        return super().find(root, words)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read every second vector of every second row."""
        assert pair.flow is not None
        flow, valid = read_flow(pair.flow)
        if flow.shape[0] % 2 or flow.shape[1] % 2:
            raise DataError(
                pair.flow, f"{flow.shape[0]}x{flow.shape[1]} vectors; Spring has two per pixel on each axis"
            )
        return Truth(flow[::2, ::2].copy(), valid[::2, ::2].copy())

    training_truth = truth

    def depth(self, sample: Sample) -> SceneDepth:
        """Return fx times 0.065 m / disparity, at most 10 km; like the flow, it is taken at every second value. The
        camera motion is fitted to depth and true flow."""
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
            check_size(depths[-1], sample.shape, path)
        (fx, fy, cx, cy), second = lenses
        camera = Camera((fx, fy), (cx, cy), second=second)
        if sample.flow is not None and sample.valid is not None:
            camera = with_motion(camera, depths[0], sample.flow, sample.valid & (depths[0] > 0))
        return scene_depth(depths[0], depths[1], camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        frames = self.pair(key).frames
        sequence = frames[0].parent.parent
        names = [frame.stem.replace("frame_", "disp1_") for frame in frames]
        maps = [sequence / name.rpartition("_")[0] / f"{name}.dsp5" for name in names]
        files = [*maps, sequence / "cam_data" / "intrinsics.txt"]
        return existing(files, "Spring", "disp1_left/, disp1_right/ and cam_data/")
