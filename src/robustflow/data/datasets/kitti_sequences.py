"""KITTI without flow, for unsupervised training: the raw drives, and KITTI 2015's multi-view extension.

Raw drives that are known to contain pairs of KITTI 2015 or 2012 are left out, unless all are requested. Frames 10 and
11 of a multi-view scene are the evaluated pair; as in ARFlow and UPFlow, frames 09 to 12 are excluded, which leaves 15
pairs per scene and camera. This does not exclude all evaluated pairs of the training scenes: many scenes of a drive are
ten frames apart, so frames 00 and 01 of a scene are frames 10 and 11 of the scene before it.
"""

from __future__ import annotations

import re
from pathlib import Path

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import user_path
from .dataset import DatasetFacts
from .kitti import drives
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles
from .places import locate, partner


class KittiRaw(LayoutDataset):
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
    layout = Layout("{drive}/{images}/data/{n}.{type}", "", "{drive}/{images}/{stem}", "{drive}", stride=0)
    cameras = {"left": ("image_02",), "right": ("image_03",), "both": ("image_02", "image_03")}

    def __init__(self, root: str | Path, camera: str = "left", drives: str = "apart", listing: str = "") -> None:
        self.options = {"camera": (camera,), "drives": (drives,), "listing": (listing,)}
        choice("camera", camera, tuple(self.cameras))
        self.leaves_out_evaluated = choice("drives", drives, ("apart", "all")) == "apart" and not listing
        super().__init__(root)

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        if not root.is_dir():
            raise DataError(root, f"no such folder; give the folder of KITTI raw that contains {self.facts.layout}")
        if words["listing"]:
            return root, _listed(root, user_path(words["listing"]))
        drive = r"\d{4}_\d\d_\d\d_drive_\d{4}(_sync)?"
        places = {
            place
            for pattern in ("*", "*/*")
            for place in root.glob(pattern)
            if place.is_dir() and re.fullmatch(drive, place.name)
        }
        if not places:
            raise DataError(root, f"not laid out like KITTI raw; expected {self.facts.layout}; check the path")
        related = (
            {*drives("kitti2015").values(), *drives("kitti2012").values()} if words["drives"] == "apart" else set()
        )
        pairs: dict[str, PairFiles] = {}
        for place in sorted(place for place in places if place.name.removesuffix("_sync") not in related):
            for images in self.cameras[words["camera"]]:
                for kind in ("png", "jpg"):
                    pairs |= self.layout.pairs(place.parent, drive=place.name, images=images, type=kind)
        if not pairs:
            raise DataError(root, f"no pair in its {len(places)} drives apart from those of KITTI; give drives=all")
        return root, pairs


def _listed(root: Path, listing: Path) -> dict[str, PairFiles]:
    try:
        lines = [line.split() for line in listing.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(listing, f"cannot be read as a list of frames ({error}); give two names per line") from error
    pairs: dict[str, PairFiles] = {}
    for number, names in enumerate(lines, 1):
        where = f"{listing}, line {number}"
        if len(names) < 2:
            raise DataError(where, f"only one name; give two frames per line, relative to {root}")
        first, second = (partner(root / name, listing) for name in names[:2])
        key = Path(names[0]).with_suffix("").as_posix()
        if key in pairs:
            raise DataError(where, "begins with the same frame as an earlier line; remove one")
        pairs[key] = PairFiles((first, second), group=first.parent.as_posix())
    return pairs


EVALUATED = ("09", "10", "11", "12")
"""Frames of a scene that are excluded: the evaluated pair of the scene and its neighbours."""


class KittiMultiview(LayoutDataset):
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
    layout = Layout("{part}/{images}/{scene:06}_{n:02}.png", "", "{part}/{images}/{stem}", "{part}/{scene}", stride=0)
    options = {"part": ("all", "training", "testing"), "camera": ("both", "left", "right")}

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        parts = {"all": ("training", "testing")}.get(words["part"], (words["part"],))
        cameras = {"left": ("image_2",), "right": ("image_3",)}.get(words["camera"], ("image_2", "image_3"))
        markers = [(part, images) for part in parts for images in cameras]
        roots, needed = ("", "data_scene_flow_multiview"), ["/".join(marker) for marker in markers]
        folder = locate(self.facts.title, root, needed, roots, self.facts.layout)
        pairs: dict[str, PairFiles] = {}
        for part, images in markers:
            if not (folder / part / images).is_dir():
                raise DataError(folder / part / images, "no such folder; unpack all of data_scene_flow_multiview.zip")
            more = self.layout.pairs(folder, part=part, images=images).items()
            pairs |= {k: p for k, p in more if not any(frame.stem.endswith(EVALUATED) for frame in p.frames)}
        if not pairs:
            raise DataError(folder, "no pair of frames but 09 to 12; unpack data_scene_flow_multiview.zip there")
        return folder, pairs
