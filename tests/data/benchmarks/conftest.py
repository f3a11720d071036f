"""A small KITTI 2015 folder that many tests use."""

import cv2
import numpy as np
import pytest
from skimage import data

import robustflow as rf


@pytest.fixture(scope="session")
def kitti(tmp_path_factory):
    """A folder in KITTI 2015's layout, with three photographs that move by (3, 1) pixels."""
    training = tmp_path_factory.mktemp("kitti") / "training"
    for folder in ("image_2", "flow_occ", "flow_noc"):
        (training / folder).mkdir(parents=True)
    flow, valid = np.full((64, 128, 2), np.float32([3, 1])), np.ones((64, 128), bool)
    valid[:20] = False
    for number in range(3):
        for frame, (dx, dy) in (("10", (0, 0)), ("11", (3, 1))):
            crop = data.astronaut()[10 - dy : 74 - dy, 10 + number - dx : 138 + number - dx, ::-1]
            cv2.imwrite(str(training / "image_2" / f"{number:06d}_{frame}.png"), crop)
        rf.write_flow(training / "flow_occ" / f"{number:06d}_10.png", flow, valid)
        rf.write_flow(training / "flow_noc" / f"{number:06d}_10.png", flow, valid & (np.arange(128) < 100))
    return training.parent
