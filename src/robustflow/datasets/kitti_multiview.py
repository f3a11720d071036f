"""KITTI 2015's multi-view extension: 21 frames of each scene without ground truth, for unsupervised training.

    training/image_2/000000_00.png ... 000000_20.png    left camera; image_3 right; 200 scenes
    testing/image_2/...                                 200 more

Frames 10 and 11 are the evaluated pair. As in ARFlow and UPFlow, frames 09 to 12 are excluded, which leaves 15 pairs
per scene and camera. This does not exclude all evaluated pairs of the training scenes: many scenes of a drive are ten
frames apart, so frames 00 and 01 of a scene are frames 10 and 11 of the scene before it. The drives of the testing
scenes are unknown. Source: Menze and Geiger, CVPR 2015.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import DataError
from ..layout import by_sequence, choice, following, locate
from .facts import DatasetFacts
from .kitti import KITTI_FRAME
from .pairs import PairDataset, PairFiles

EVALUATED = range(9, 13)
"""Frames of a scene that are excluded: the evaluated pair of the scene and its neighbours."""
_CAMERAS = {"left": ("image_2",), "right": ("image_3",), "both": ("image_2", "image_3")}
_PARTS = {"training": ("training",), "testing": ("testing",), "all": ("training", "testing")}


class KittiMultiview(PairDataset):
    """The multi-view extension of KITTI 2015. `root` contains `training/` and `testing/`."""

    name = "kitti_multiview"
    has_flow = False
    facts = DatasetFacts(
        title="KITTI 2015 multi-view",
        description="21 frames of each scene of KITTI 2015, without the scene's evaluated frames and their neighbours.",
        ground_truth="none",
        clips="always",
        licence="CC BY-NC-SA 3.0",
        citation="Menze and Geiger, Object Scene Flow for Autonomous Vehicles, CVPR 2015",
        layout="training/image_2, training/image_3, testing/image_2, testing/image_3, with frames _00 to _20",
        training_set="kitti-raw",
        same_domain=("kitti2015", "kitti2012"),
    )

    def __init__(self, root: str | Path, part: str = "all", camera: str = "both") -> None:
        parts = _PARTS[choice("part", part, tuple(_PARTS))]
        cameras = _CAMERAS[choice("camera", camera, tuple(_CAMERAS))]
        markers = [f"{one}/{images}" for one in parts for images in cameras]
        expected = " and ".join(f"{marker}/" for marker in markers) + " with frames 000000_00.png to 000000_20.png"
        folder = locate("KITTI 2015 multi-view", root, markers, ("", "data_scene_flow_multiview"), expected)
        pairs: dict[str, PairFiles] = {}
        for marker in markers:
            if not (folder / marker).is_dir():
                raise DataError(f"{folder}: no {marker}/; unpack all of data_scene_flow_multiview.zip")
            pairs |= _pairs(folder, marker)
        if not pairs:
            raise DataError(
                f"{folder}: no two consecutive frames apart from 09 to 12; unpack data_scene_flow_multiview.zip "
                "there, which contains _00 to _20 of each scene"
            )
        super().__init__(pairs, folder)


def _pairs(folder: Path, marker: str) -> dict[str, PairFiles]:
    part = marker.partition("/")[0]
    return {
        f"{marker}/{first.stem}": PairFiles((first, second), group=f"{part}/{scene}")
        for scene, frames in by_sequence(folder / marker, KITTI_FRAME).items()
        for first, second in following({number: path for number, path in frames.items() if number not in EVALUATED})
    }
