"""KITTI flow 2015 and 2012: 200 and 194 training pairs of driving, sparse ground truth from a laser scanner.

`flow_occ` is the ground truth; a pixel that has flow in `flow_occ` but not in `flow_noc` is occluded. If a folder
contains only `flow_noc`, these maps are the ground truth, there are no occlusion maps, and `non_occluded` is set,
because errors on visible pixels are smaller. The two kinds of ground truth are never mixed within a run, and KITTI-FC
requires `flow_occ`. (In 2015 both maps contain the same vectors. In 2012 they differ by up to a few pixels, as they
were filled in separately.) For depth, 2015 has the disparity of both frames at the pixels of frame 1 (disp_occ_0 and 1,
in 1/256 pixel) and calib_cam_to_cam. The multi-view extension adds 000010_00.png to 000010_20.png of each pair; if they
are in the same folder, multi-frame models get the frames around each pair.

The group of a pair is the drive in which it was recorded, from data/*_drives.csv: 142 of the 200 pairs in 29 drives, 89
of the 194 in 16. The numbers for 2015 are from `mapping/train_mapping.txt` in the development kit (Menze and Geiger,
CVPR 2015), whose lines are empty if the drive is not in the public raw data; those for 2012 are the pairs that Meister,
Hur and Roth (UnFlow, AAAI 2018) found in the raw data. The pairs of 2015 are numbered in the order of drives, and the
raw data contain all of a drive or none of it, so a block of pairs without a drive shares none with its neighbours; it
forms one group: too many pairs may be treated as related, but never too few. The pairs of 2012 are numbered at random,
so all pairs without a drive form one group (`docs/design/uncertainty.md`).
"""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...core.errors import DataError
from ...core.types import Camera, Frame, Mask, Sample, SceneDepth
from ...media.depth import read_depth_png
from ...media.flow import read_flow
from .dataset import DatasetFacts
from .depth import SKY, carried, check_size, depth_of, existing, scene_depth, with_motion
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles, Truth
from .places import locate

_TABLES = {
    "kitti2015": ("kitti2015", 200),
    "kitti_fc_released": ("kitti2015", 200),
    "kitti2012": ("kitti2012", 194),
}
"""Table of pairs and number of pairs for each dataset. The released KITTI-FC keeps the numbering of 2015."""


@cache
def drives(dataset: str) -> Mapping[str, str]:
    """Return the drive of each pair whose drive is known; empty for datasets other than KITTI's."""
    if dataset not in _TABLES:
        return {}
    table = files("robustflow.data.datasets") / "data" / f"{_TABLES[dataset][0]}_drives.csv"
    return {line["pair"]: line["drive"] for line in csv.DictReader(table.read_text(encoding="utf-8").splitlines())}


@cache
def drive_groups(dataset: str) -> Mapping[str, str]:
    """Return the group of each pair: its drive or a substitute; empty for datasets other than KITTI's."""
    if dataset not in _TABLES:
        return {}
    table, count = _TABLES[dataset]
    drive_of, groups = drives(dataset), dict[str, str]()
    for has_drive, run in groupby((f"{number:06d}" for number in range(count)), key=drive_of.__contains__):
        members = list(run)
        if has_drive:
            groups |= {pair: drive_of[pair] for pair in members}
        else:
            block = dict.fromkeys((members[0], members[-1])) if table == "kitti2015" else ()
            groups |= dict.fromkeys(members, "_".join(("unmapped", *block)))
    return groups


def related(first: Iterable[str], second: Iterable[str]) -> list[str]:
    drive_of = drives("kitti2015")
    others = {drive_of[pair] for pair in second if pair in drive_of}
    return [pair for pair in first if drive_of.get(pair) in others]


_BRIGHT, _DETAIL = 240, 5
_MEASURED = 0.01


def sky(frame: Frame, measured: Mask) -> Mask:
    """Return the mask of the sky, bool (H, W), which the laser scanner does not measure.

    Sky is a bright area (blue at least 240, without parts narrower than five pixels) that reaches the upper edge of the
    frame and of which less than one pixel in a hundred was measured. The last condition excludes sunlit walls: they
    continue below the highest beam of the scanner. Sky enclosed by trees is missed.
    """
    bright = cv2.morphologyEx((frame[..., 2] >= _BRIGHT).astype(np.uint8), cv2.MORPH_OPEN, np.ones((_DETAIL, _DETAIL)))
    count, areas = cv2.connectedComponents(bright, connectivity=4)
    sizes, measured_sizes = np.bincount(areas.ravel(), minlength=count), np.bincount(areas[measured], minlength=count)
    is_sky = measured_sizes < _MEASURED * sizes
    is_sky[0] = False
    is_sky &= np.isin(np.arange(count), areas[0])
    return np.asarray(is_sky[areas])


class KittiPairs(LayoutDataset):
    """Pairs with ground truth in KITTI's format: `PairFiles.flow` is the occ or noc map, and `PairFiles.occlusion` the
    noc map that belongs to an occ map."""

    roots = ("", "training")
    layout = Layout(
        "{images}/{pair:06}_{n:02}.png", "{truth}/{pair:06}_{n:02}.png", "{pair}", first=10, more_frames=True
    )

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        images = {"auto": ["colored_0", "image_0"], "colour": ["colored_0"], "grey": ["image_0"]}
        kinds = images[words["images"]] if "images" in words else ["image_2"]
        folder = locate(self.facts.title, root, kinds, self.roots, f"{' or '.join(kinds)}/ and flow_occ/")
        words["images"] = next(kind for kind in kinds if (folder / kind).is_dir())
        truths = [kind for kind in ("flow_occ", "flow_noc") if (folder / kind).is_dir()]
        if not truths:
            raise DataError(folder, "no flow_occ/ or flow_noc/; dataset 'folder' reads frames without ground truth")
        self.non_occluded = truths[0] == "flow_noc"
        groups, missing = drive_groups(self.name), list[str]()
        pairs = self.layout.pairs(folder, truth=truths[0], **words)
        for key, pair in pairs.items():
            visible = folder / truths[-1] / f"{key}_10.png" if len(truths) == 2 else None
            if visible is not None and not visible.is_file():
                missing.append(visible.name)
                visible = None
            pairs[key] = replace(pair, occlusion=visible, group=groups.get(key, ""))
        if missing:
            lost = f"{len(missing)} of {len(pairs)} maps are missing ({min(missing)}, ...)"
            warnings.warn(f"{folder / 'flow_noc'}: {lost}; these pairs have no errors by occlusion", stacklevel=4)
        return folder, pairs

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read flow from the occ map; pixels that are missing in the noc map are occluded."""
        assert pair.flow is not None
        flow, valid = read_flow(pair.flow)
        if pair.occlusion is None:
            return Truth(flow, valid)
        visible = read_flow(pair.occlusion)[1]
        if visible.shape != valid.shape:
            raise DataError(pair.occlusion, f"different size from {pair.flow}; the files do not match")
        return Truth(flow, valid, valid & ~visible)

    def describe(self, pair: PairFiles) -> dict[str, Any]:
        return {"ground_truth": "noc" if self.non_occluded else "occ"}


class Kitti2015(KittiPairs):
    """The KITTI 2015 dataset. `root` is `training/` or its parent folder."""

    name = "kitti2015"
    facts = DatasetFacts(
        title="KITTI flow 2015",
        description="Driving with moving cars, about 375x1242.",
        ground_truth="sparse",
        pairs=200,
        depth="disparity and calibration",
        clips="with the multi-view extension",
        licence="CC BY-NC-SA 3.0",
        citation="Menze and Geiger, Object Scene Flow for Autonomous Vehicles, CVPR 2015",
        layout="training/image_2, training/flow_occ, training/flow_noc",
        training_set="kitti2015",
        same_domain=("kitti2012", "kitti-raw"),
    )

    def depth(self, sample: Sample) -> SceneDepth:
        """Return f B / disparity, with f and B of the rectified colour cameras. `disp_occ_1` contains the disparity in
        frame 2 at the pixels of frame 1; the true flow gives their positions in frame 2. The camera motion is fitted to
        depth and flow. The sky is 10 km away."""
        first, second, calibration = self.depth_files(sample.key)
        camera, scale = _calibration(calibration)
        now, then = (depth_of(read_depth_png(path), 256 * scale) for path in (first, second))
        for values, path in ((now, first), (then, second)):
            check_size(values, sample.shape, path)
        assert sample.flow is not None
        assert sample.valid is not None
        camera = with_motion(camera, now, sample.flow, sample.valid & (now > 0))
        moved = carried(then, sample.flow, sample.valid & (then > 0))
        depth = scene_depth(now, moved, camera, self.name, sample)
        for frame, metres, measured in zip(sample.frames[:2], depth.maps, depth.measured, strict=True):
            metres[sky(frame, measured)] = SKY
        return depth

    def depth_files(self, key: str) -> list[Path]:
        name = self.pair(key).frames[0].name
        files = [self.folder / kind / name for kind in ("disp_occ_0", "disp_occ_1")]
        files.append(self.folder / "calib_cam_to_cam" / f"{key}.txt")
        return existing(files, "KITTI 2015", "data_scene_flow and data_scene_flow_calib")


class Kitti2012(KittiPairs):
    """The KITTI 2012 dataset. `root` is `training/` or its parent folder."""

    name = "kitti2012"
    facts = DatasetFacts(
        title="KITTI flow 2012",
        description="Driving through static scenes, about 375x1242.",
        ground_truth="sparse",
        pairs=194,
        clips="with the multi-view extension",
        licence="CC BY-NC-SA 3.0",
        citation="Geiger, Lenz and Urtasun, Are We Ready for Autonomous Driving?, CVPR 2012",
        layout="training/colored_0 or training/image_0, training/flow_occ, training/flow_noc",
        training_set="kitti2012",
        same_domain=("kitti2015", "kitti-raw"),
    )
    options = {"images": ("auto", "colour", "grey")}


def _calibration(path: Path) -> tuple[Camera, float]:
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        entries = {name: values for name, _, values in (line.partition(":") for line in lines)}
        left, right = ([float(word) for word in entries[f"P_rect_{number}"].split()] for number in ("02", "03"))
        (fx, _, cx, at_left, _, fy, cy, *_), (at_right, *_) = left, right[3:]
    except (OSError, ValueError, KeyError) as error:
        raise DataError(path, "no calibration with P_rect_02 and P_rect_03; restore the file") from error
    scale = at_left - at_right
    if not all(0 < value < 1e6 for value in (fx, fy, scale)):
        raise DataError(path, "a focal length or baseline is not positive; restore the file")
    return Camera((fx, fy), (cx, cy)), scale
