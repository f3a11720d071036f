"""KITTI's raw data: the drives from which the flow benchmarks were taken; rectified frames at 10 Hz, without flow.
KITTI 2015's multi-view extension: 21 frames of each scene without ground truth, for unsupervised training.

    2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000000.png ...    left colour camera; image_03 right

Drives that are known to contain pairs of KITTI 2015 or 2012 are left out, unless all are requested. Source: Geiger,
Lenz, Stiller and Urtasun, IJRR 2013.

    training/image_2/000000_00.png ... 000000_20.png    left camera; image_3 right; 200 scenes
    testing/image_2/...                                 200 more

Frames 10 and 11 are the evaluated pair. As in ARFlow and UPFlow, frames 09 to 12 are excluded, which leaves 15 pairs
per scene and camera. This does not exclude all evaluated pairs of the training scenes: many scenes of a drive are ten
frames apart, so frames 00 and 01 of a scene are frames 10 and 11 of the scene before it. The drives of the testing
scenes are unknown. Source: Menze and Geiger, CVPR 2015.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import by_sequence, folders, following, locate, numbered, partner, user_path
from .base import DatasetFacts
from .kitti import KITTI_FRAME, drives
from .pairs import PairDataset, PairFiles

_CAMERAS = {"left": ("image_02",), "right": ("image_03",), "both": ("image_02", "image_03")}
_EXPECTED = "2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000000.png ..."


class KittiRaw(PairDataset):
    """The KITTI raw dataset. `root` contains one folder of drives per day, or is such a folder."""

    name = "kitti_raw"
    has_flow = False
    facts = DatasetFacts(
        title="KITTI raw",
        description="Complete drives with a car, about 375x1242 at 10 Hz.",
        ground_truth="none",
        clips="always",
        licence="CC BY-NC-SA 3.0",
        citation="Geiger, Lenz, Stiller and Urtasun, Vision meets Robotics: The KITTI Dataset, IJRR 2013",
        layout="2011_09_26/2011_09_26_drive_0001_sync/image_02/data, and other days and drives",
        training_set="kitti-raw",
        same_domain=("kitti2015", "kitti2012"),
    )

    def __init__(self, root: str | Path, camera: str = "left", drives: str = "apart", listing: str = "") -> None:
        cameras = _CAMERAS[choice("camera", camera, tuple(_CAMERAS))]
        self.leaves_out_evaluated = choice("drives", drives, ("apart", "all")) == "apart" and not listing
        root = user_path(root)
        if not root.is_dir():
            raise DataError(root, f"no such folder; give the folder of KITTI raw that contains {_EXPECTED}")
        if listing:
            super().__init__(_listed(root, user_path(listing)), root)
            return
        drive_folders = list(_drives(root))
        if not drive_folders:
            raise DataError(
                root, f"not laid out like KITTI raw; expected {_EXPECTED}; check the path, or unpack it there"
            )
        known = _evaluated() if drives == "apart" else frozenset()
        pairs = {
            f"{drive.name}/{images}/{first.stem}": PairFiles((first, second), group=drive.name)
            for drive in drive_folders
            if drive.name.removesuffix("_sync") not in known
            for images in cameras
            for first, second in following(numbered(drive / images / "data", r"(\d{1,10})\.(?:png|jpg)"))
        }
        if not pairs:
            raise DataError(
                root,
                f"no pair of frames in its {len(drive_folders)} drives, apart from those of KITTI 2015 and "
                "2012; unpack more drives, or give drives=all",
            )
        super().__init__(pairs, root)


def _evaluated() -> frozenset[str]:
    return frozenset({*drives("kitti2015").values(), *drives("kitti2012").values()})


def _drives(root: Path) -> Iterator[Path]:
    for day in (root, *folders(root)):
        for drive in folders(day):
            if re.fullmatch(r"\d{4}_\d\d_\d\d_drive_\d{4}(_sync)?", drive.name):
                yield drive


def _listed(root: Path, listing: Path) -> dict[str, PairFiles]:
    try:
        lines = [line.split() for line in listing.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(listing, f"cannot be read as a list of frames ({error}); give two names per line") from error
    pairs: dict[str, PairFiles] = {}
    for number, names in enumerate(lines, 1):
        if len(names) < 2:
            raise DataError(f"{listing}, line {number}: only one name; give two frames per line, relative to {root}")
        first, second = (partner(root / name, listing) for name in names[:2])
        key = Path(names[0]).with_suffix("").as_posix()
        if key in pairs:
            raise DataError(f"{listing}, line {number}: begins with the same frame as an earlier line; remove one")
        pairs[key] = PairFiles((first, second), group=first.parent.as_posix())
    return pairs


EVALUATED = range(9, 13)
"""Frames of a scene that are excluded: the evaluated pair of the scene and its neighbours."""
_CAMERAS_KITTI_MULTIVIEW = {"left": ("image_2",), "right": ("image_3",), "both": ("image_2", "image_3")}
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
        cameras = _CAMERAS_KITTI_MULTIVIEW[choice("camera", camera, tuple(_CAMERAS_KITTI_MULTIVIEW))]
        markers = [f"{one}/{images}" for one in parts for images in cameras]
        expected = " and ".join(f"{marker}/" for marker in markers) + " with frames 000000_00.png to 000000_20.png"
        folder = locate("KITTI 2015 multi-view", root, markers, ("", "data_scene_flow_multiview"), expected)
        pairs: dict[str, PairFiles] = {}
        for marker in markers:
            if not (folder / marker).is_dir():
                raise DataError(folder, f"no {marker}/; unpack all of data_scene_flow_multiview.zip")
            pairs |= _pairs(folder, marker)
        if not pairs:
            raise DataError(
                folder,
                "no two consecutive frames apart from 09 to 12; unpack data_scene_flow_multiview.zip "
                "there, which contains _00 to _20 of each scene",
            )
        super().__init__(pairs, folder)


def _pairs(folder: Path, marker: str) -> dict[str, PairFiles]:
    part = marker.partition("/")[0]
    return {
        f"{marker}/{first.stem}": PairFiles((first, second), group=f"{part}/{scene}")
        for scene, frames in by_sequence(folder / marker, KITTI_FRAME).items()
        for first, second in following({number: path for number, path in frames.items() if number not in EVALUATED})
    }
