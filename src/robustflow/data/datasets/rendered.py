"""Rendered datasets with depth: MPI-Sintel, Spring (needs the extra `h5`) and TartanAir.

    training/depth/alley_1/frame_0001.dpt           Sintel: metres
    training/camdata_left/alley_1/frame_0001.cam    the camera
    train/0001/disp1_left/disp1_left_0001.dsp5      Spring: disparity, in pixels; 0 in the sky, NaN where unknown
    train/0001/cam_data/intrinsics.txt              fx fy cx cy of each frame
    office/Easy/P000/depth_left/000000_left_depth.npy   TartanAir: float32 (H, W), metres
    office/Easy/P000/pose_left.txt                  tx ty tz qx qy qz qw of each frame
    office/Easy/P000/flow/000000_000001_mask.npy    uint8 (H, W): 0 visible in the next frame, 1 or 10 occluded, 100 out
                                                    of view

Spring stores four vectors per pixel; like the benchmark's own reader, this one takes every second vector in both
directions. TartanAir's pixels out of view are not evaluated, because they include points behind the camera, whose
vectors are meaningless (`flow_and_warping_error.py` in tartanair_tools).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...core.errors import DataError
from ...core.paths import folders, locate
from ...core.plugins import require
from ...core.types import Camera, Mask, Sample, SceneDepth
from ...media.arrays import known, read_npy
from ...media.depth import read_camera, read_depth_npy, read_dpt, read_dsp5
from ...media.flow import read_flow
from ...media.images import read_mask
from .base import DatasetFacts
from .depth import SKY, check_size, depth_of, existing, relative_motion, scene_depth, table_of, with_motion
from .layout import Layout, LayoutDataset
from .pairs import PairFiles, Truth

_SINTEL_MAPS = ("flow", "occlusions", "invalid", "flow_viz", "depth", "depth_viz", "camdata_left")


class Sintel(LayoutDataset):
    """The MPI-Sintel dataset. `root` is `training/` or its parent folder."""

    name = "sintel"
    facts = DatasetFacts(
        title="MPI-Sintel",
        description="23 scenes of an animated film, 436x1024, in a clean and a final rendering.",
        pairs=1041,
        depth="exact, with its depth package",
        clips="always",
        licence="film CC BY 3.0; data for research, see the distributor's terms",
        citation="Butler et al., A Naturalistic Open Source Movie for Optical Flow Evaluation, ECCV 2012",
        layout="training/clean, training/final, training/flow, training/occlusions, training/invalid",
        training_set="sintel",
    )
    layout = Layout(
        "{render_pass}/{scene}/frame_{n:04}.png",
        "flow/{scene}/frame_{n:04}.flo",
        "{scene}/frame_{n:04}",
        "{scene}",
        {"occlusion": "occlusions/{scene}/frame_{n:04}.png", "invalid": "invalid/{scene}/frame_{n:04}.png"},
    )

    def __init__(self, root: str | Path, render_pass: str = "clean") -> None:
        self.options = {"render_pass": (render_pass,)}
        super().__init__(root)

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        folder = locate(self.facts.title, root, ["flow"], ("training", ""), self.facts.layout)
        passes = [path.name for path in folders(folder) if path.name not in _SINTEL_MAPS]
        if words["render_pass"] not in passes:
            raise DataError(folder, f"no pass '{words['render_pass']}'; choose render_pass from {', '.join(passes)}")
        return folder, self.layout.pairs(folder, **words)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read the flow, excluding the pixels marked in `invalid`, and the occlusion map."""
        assert pair.flow is not None
        flow, valid = read_flow(pair.flow)
        if pair.invalid is not None:
            valid &= ~_fitting(pair.invalid, valid.shape)
            flow[~valid] = 0
        return Truth(flow, valid, None if pair.occlusion is None else _fitting(pair.occlusion, valid.shape))

    def depth(self, sample: Sample) -> SceneDepth:
        *maps, first, second = self.depth_files(sample.key)
        lenses, poses = zip(*(read_camera(path) for path in (first, second)), strict=True)
        (fx, fy, cx, cy), moved = ((float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])) for k in lenses)
        camera = Camera((fx, fy), (cx, cy), *relative_motion(*poses), moved)
        now, then = (read_dpt(path) for path in maps)
        return scene_depth(now, then, camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        frames = self.pair(key).frames
        training, scene = frames[0].parents[2], frames[0].parent.name
        kinds = (("depth", ".dpt"), ("camdata_left", ".cam"))
        files = [training / kind / scene / f"{frame.stem}{suffix}" for kind, suffix in kinds for frame in frames]
        return existing(files, "MPI-Sintel", "MPI-Sintel-depth-training")


def _fitting(path: Path, shape: tuple[int, ...]) -> Mask:
    mask = read_mask(path)
    if mask.shape != shape:
        raise DataError(path, f"{mask.shape[0]}x{mask.shape[1]} pixels, but the flow has {shape[0]}x{shape[1]}")
    return mask


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


_LEVELS = ("Easy", "Hard")
_FOCAL, _CENTRE = 320.0, (320.0, 240.0)
_OUT_OF_VIEW = 100


class TartanAir(LayoutDataset):
    """The TartanAir dataset, left camera. `root` contains the folders of the environments, or is one of them."""

    name = "tartanair"
    facts = DatasetFacts(
        title="TartanAir",
        description="369 flights through 18 rendered environments, 480x640.",
        pairs=306268,
        depth="exact",
        clips="always",
        licence="CC BY 4.0",
        citation="Wang et al., TartanAir: A Dataset to Push the Limits of Visual SLAM, IROS 2020",
        layout="abandonedfactory/Easy/P000/image_left, abandonedfactory/Easy/P000/flow",
        training_set="tartanair",
    )
    layout = Layout(
        "{difficulty}/{flight}/image_left/{n:06}_left.png",
        "{difficulty}/{flight}/flow/{n:06}_{m:06}_flow.npy",
        "{environment}/{difficulty}/{flight}/{n:06}",
        "{environment}/{difficulty}/{flight}",
        {"occlusion": "{difficulty}/{flight}/flow/{n:06}_{m:06}_mask.npy"},
        stride=0,
    )
    options = {"difficulty": ("all", *_LEVELS)}

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        """See `LayoutDataset.find`. The unpacked archives nest the folders of the environments."""
        pairs: dict[str, PairFiles] = {}
        for environment in (root, *folders(root)):
            for place in (environment, environment / environment.name):
                for level in _LEVELS if words["difficulty"] == "all" else (words["difficulty"],):
                    if (place / level).is_dir():
                        pairs |= self.layout.pairs(place, environment=environment.name, difficulty=level)
        if not pairs:
            locate(self.facts.title, root, ["no environment"], expected=self.facts.layout)
        return root, pairs

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read flow and mask; pixels out of view are unknown, as in the training of SEA-RAFT."""
        assert pair.flow is not None
        assert pair.occlusion is not None
        flow, mask = read_npy(pair.flow, "a flow", (2,)), read_npy(pair.occlusion, "a mask")
        if mask.shape != flow.shape[:2]:
            raise DataError(pair.flow, f"{flow.shape} with a mask of {mask.shape}; the files do not match")
        flow, valid = known(flow)
        valid &= mask < _OUT_OF_VIEW
        flow[~valid] = 0
        return Truth(flow, valid, valid & (mask > 0))

    training_truth = truth

    def depth(self, sample: Sample) -> SceneDepth:
        """Return the exact depth. The poses are in a north-east-down world frame; the camera's axes are x forward, y
        right and z down."""
        *maps, poses = self.depth_files(sample.key)
        table = table_of(poses, 7)
        places = [int(path.name[:6]) for path in maps]
        if max(places) >= len(table):
            raise DataError(poses, f"{len(table)} poses, but none for frame {max(places)}; restore the file")
        motion = relative_motion(*(_world_to_camera(table[place].tolist(), poses) for place in places))
        camera = Camera((_FOCAL, _FOCAL), _CENTRE, *motion)
        now, then = (read_depth_npy(path) for path in maps)
        return scene_depth(now, then, camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        frames = self.pair(key).frames
        flight = frames[0].parent.parent
        maps = [flight / "depth_left" / f"{frame.stem}_depth.npy" for frame in frames]
        return existing([*maps, flight / "pose_left.txt"], "TartanAir", "depth_left/ and pose_left.txt of the flights")


def _world_to_camera(pose: list[float], path: Path) -> npt.NDArray[np.float64]:
    """Return the world-to-camera matrix (3, 4), for camera axes x right, y down, z forward, from a pose tx ty tz qx qy
    qz qw, which rotates and then translates a camera with axes x forward, y right, z down."""
    tx, ty, tz, x, y, z, w = pose
    squared = x * x + y * y + z * z + w * w
    if not 0.5 < squared < 2:
        raise DataError(path, f"contains a quaternion of length {squared**0.5:.3g}; restore the file")
    s = 2 / squared
    right = (s * (x * y - z * w), 1 - s * (x * x + z * z), s * (y * z + x * w))
    down = (s * (x * z + y * w), s * (y * z - x * w), 1 - s * (x * x + y * y))
    forward = (1 - s * (y * y + z * z), s * (x * y + z * w), s * (x * z - y * w))
    return np.array([[*axis, -(axis[0] * tx + axis[1] * ty + axis[2] * tz)] for axis in (right, down, forward)])
