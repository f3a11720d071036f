"""TartanAir: 369 flights through 18 rendered environments, 480x640, dense ground truth; left camera.

    abandonedfactory/Easy/P000/image_left/000000_left.png ...
    abandonedfactory/Easy/P000/flow/000000_000001_flow.npy ...      float32 (H, W, 2), pixels
    abandonedfactory/Easy/P000/flow/000000_000001_mask.npy ...      uint8 (H, W): 0 visible in the next frame,
                                                                    1 or 10 occluded, 100 out of view
    abandonedfactory/Easy/P000/depth_left/000000_left_depth.npy     for depth: float32 (H, W), metres
    abandonedfactory/Easy/P000/pose_left.txt                        for depth: tx ty tz qx qy qz qw of each frame

The flow is computed from depth and camera motion. Pixels out of view are not evaluated, because they include points
behind the camera, whose vectors are meaningless. The environment's folder may be nested, as in the unpacked archives
(abandonedfactory/abandonedfactory/Easy). Source: Wang et al., IROS 2020, and `flow_and_warping_error.py` in their
tartanair_tools.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import folders, following, locate, numbered, partner, user_path
from ...core.types import Camera, Sample, SceneDepth
from ...media.arrays import known
from ...media.depth import read_depth_npy, read_npy
from .base import DatasetFacts
from .depth import existing, scene_depth, table_of
from .motorcycle import relative_motion
from .pairs import PairDataset, PairFiles, Truth

_DIFFICULTIES = ("Easy", "Hard")
_FOCAL, _CENTRE = 320.0, (320.0, 240.0)
_OUT_OF_VIEW = 100
_EXPECTED = "ENVIRONMENT/Easy/P000/image_left/ and ENVIRONMENT/Easy/P000/flow/"


class TartanAir(PairDataset):
    """The TartanAir dataset. `root` contains the folders of the environments, or is one of them."""

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

    def __init__(self, root: str | Path, difficulty: str = "all") -> None:
        choice("difficulty", difficulty, ("all", *_DIFFICULTIES))
        folder = user_path(root)
        pairs: dict[str, PairFiles] = {}
        for environment, place in _environments(folder):
            for level in _DIFFICULTIES if difficulty == "all" else (difficulty,):
                for flight in folders(place / level):
                    pairs.update(_flight(flight, f"{environment}/{level}/{flight.name}"))
        if not pairs:
            locate("TartanAir", folder, ["no environment"], expected=_EXPECTED)
        super().__init__(pairs, folder)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read flow and mask; pixels out of view are unknown, as in the training of SEA-RAFT."""
        if pair.flow is None or pair.occlusion is None:
            return None
        flow, mask = read_npy(pair.flow, "a flow", (2,)), read_npy(pair.occlusion, "a mask")
        if mask.shape != flow.shape[:2]:
            raise DataError(pair.flow, f"{flow.shape} with a mask of {mask.shape}; the files do not match")
        flow, valid = known(flow)
        valid &= mask < _OUT_OF_VIEW
        flow[~valid] = 0
        return Truth(flow, valid, valid & (mask > 0))

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. The depth is exact. The poses are in a north-east-down world frame; the camera's axes are
        x forward, y right and z down."""
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
        """See `Depths.depth_files`."""
        frames = self.pair(key).frames
        flight = frames[0].parent.parent
        maps = [flight / "depth_left" / f"{frame.stem}_depth.npy" for frame in frames]
        return existing([*maps, flight / "pose_left.txt"], "TartanAir", "depth_left/ and pose_left.txt of the flights")

    def training_truth(self, pair: PairFiles) -> Truth | None:
        """See `PairDataset.training_truth`."""
        return self.truth(pair)


def _environments(root: Path) -> list[tuple[str, Path]]:
    """Return the name and folder of each environment."""
    environments = []
    for folder in [root, *folders(root)]:
        for place in (folder, folder / folder.name):
            if any((place / level).is_dir() for level in _DIFFICULTIES):
                environments.append((folder.name, place))
    return environments


def _flight(flight: Path, group: str) -> dict[str, PairFiles]:
    images, flows = flight / "image_left", flight / "flow"
    pairs = {}
    for first, second in following(numbered(images, r"(\d{6})_left\.png")):
        name = f"{first.name[:6]}_{second.name[:6]}"
        flow = partner(flows / f"{name}_flow.npy", first)
        mask = partner(flows / f"{name}_mask.npy", first)
        pairs[f"{group}/{first.name[:6]}"] = PairFiles((first, second), flow, occlusion=mask, group=group)
    return pairs


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
