"""A small KITTI 2015 folder that many tests use."""

import cv2
import numpy as np
import pytest
from skimage import data

import robustflow as rf


def make_kitti(root, pairs: int) -> None:
    """A folder in KITTI 2015's layout, with photographs that move by (3, 1) pixels."""
    texture = data.astronaut()
    for folder in ("image_2", "flow_occ", "flow_noc"):
        (root / "training" / folder).mkdir(parents=True)
    for number in range(pairs):
        x = number % 100
        for frame, (dx, dy) in (("10", (0, 0)), ("11", (3, 1))):
            crop = texture[10 - dy : 74 - dy, 10 + x - dx : 138 + x - dx, ::-1]
            cv2.imwrite(str(root / "training" / "image_2" / f"{number:06d}_{frame}.png"), crop)
        flow = np.broadcast_to(np.float32([3, 1]), (64, 128, 2))
        valid = np.ones((64, 128), bool)
        valid[:20] = False
        rf.write_flow(root / "training" / "flow_occ" / f"{number:06d}_10.png", flow, valid)
        valid = valid.copy()
        valid[:, 100:] = False
        rf.write_flow(root / "training" / "flow_noc" / f"{number:06d}_10.png", flow, valid)


@pytest.fixture(scope="module")
def kitti(tmp_path_factory):
    root = tmp_path_factory.mktemp("kitti")
    make_kitti(root, 3)
    return root
