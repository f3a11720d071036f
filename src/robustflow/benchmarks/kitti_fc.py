"""`kitti-fc`: 20 corruptions on 80 of KITTI-2015's 200 training pairs (paper Sec. 4.2)."""

from __future__ import annotations

from pathlib import Path

from ..corruptions import IMAGE_PAIR
from ..datasets import load_dataset
from ..datasets.kitti_fc import KittiFC
from ..datasets.split import kitti_split, selected
from ..errors import UsageError
from .base import Benchmark
from .released import released


def kitti_fc(data: Path | None, split: Path | None) -> Benchmark:
    """KITTI-FC from the KITTI-2015 folder, corrupted on the fly, or from the released KITTI-FC folder as it is.

    The paper drew its 80 pairs without a seed and names them nowhere but in its 44 GB download; here they come from a
    documented seed, or from `split`: a file, or "drive-disjoint", whose pairs share no drive with the others. A folder
    with fewer than 200 pairs is evaluated whole.
    """
    if data is None:
        raise UsageError("kitti-fc needs the KITTI-2015 folder: give --data PATH (the folder that holds training/)")
    if (data / "clean").is_dir():
        found = KittiFC(data)
        return released("kitti-fc", found, selected(split, found.keys(), found.name) if split else found.keys())
    dataset = load_dataset("kitti2015", data)
    keys = selected(split, dataset.keys(), dataset.name) if split else kitti_split(dataset.keys()).evaluation
    return Benchmark("kitti-fc", dataset, tuple(keys), IMAGE_PAIR)
