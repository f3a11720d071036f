"""TartanAir.

    office/Easy/P000/depth_left/000000_left_depth.npy   float32 (H, W), metres
    office/Easy/P000/pose_left.txt                  tx ty tz qx qy qz qw of each frame
    office/Easy/P000/flow/000000_000001_mask.npy    uint8 (H, W): 0 visible in the next frame, 1 or 10 occluded, 100 out
                                                    of view

Pixels out of view are not evaluated, because they include points behind the camera, whose vectors are meaningless
(`flow_and_warping_error.py` in tartanair_tools).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...core.errors import DataError
from ...core.paths import folders
from ...core.types import Camera, Sample, SceneDepth
from ...media.arrays import known, read_npy
from ...media.depth import read_depth_npy
from .dataset import DatasetFacts
from .depth import existing, relative_motion, scene_depth, table_of
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles, Truth
from .places import locate

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
