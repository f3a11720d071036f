"""KITTI's raw data: the drives from which the flow benchmarks were taken; rectified frames at 10 Hz, without flow.

    2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000000.png ...    left colour camera; image_03 right

Drives that are known to contain pairs of KITTI 2015 or 2012 are left out, unless all are requested. Source: Geiger,
Lenz, Stiller and Urtasun, IJRR 2013.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ..errors import DataError
from ..layout import choice, folders, following, numbered, partner, user_path
from .facts import DatasetFacts
from .kitti_drives import drives
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
            raise DataError(f"{root}: no such folder; give the folder of KITTI raw that contains {_EXPECTED}")
        if listing:
            super().__init__(_listed(root, user_path(listing)), root)
            return
        drive_folders = list(_drives(root))
        if not drive_folders:
            raise DataError(
                f"{root}: not laid out like KITTI raw; expected {_EXPECTED}; check the path, or unpack it there"
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
                f"{root}: no pair of frames in its {len(drive_folders)} drives, apart from those of KITTI 2015 and "
                "2012; unpack more drives, or give drives=all"
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
        raise DataError(f"{listing}: cannot be read as a list of frames ({error}); give two names per line") from error
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
