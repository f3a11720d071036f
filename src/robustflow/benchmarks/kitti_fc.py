"""`kitti-fc`: 20 corruptions on 80 of KITTI-2015's 200 training pairs (paper Sec. 4.2)."""

from __future__ import annotations

from pathlib import Path

from ..corruptions import IMAGE_PAIR, SEVERITIES
from ..datasets import load_dataset
from ..datasets.kitti_fc import KittiFC
from ..datasets.split import kitti_split, read_split
from ..errors import DataError, UsageError
from .base import Benchmark


def kitti_fc(data: Path | None, split: Path | None) -> Benchmark:
    """KITTI-FC from the KITTI-2015 folder, corrupted on the fly, or from the released KITTI-FC folder as it is.

    The paper drew its 80 pairs without a seed and names them nowhere but in its 44 GB download; here they come from a
    documented seed, or from `split`. A folder with fewer than 200 pairs is evaluated whole.
    """
    if data is None:
        raise UsageError("kitti-fc needs the KITTI-2015 folder: give --data PATH (the folder that holds training/)")
    if (data / "clean").is_dir():
        return _released(KittiFC(data), split)
    dataset = load_dataset("kitti2015", data)
    keys = read_split(split, dataset.keys()) if split else kitti_split(dataset.keys()).evaluation
    return Benchmark("kitti-fc", dataset, tuple(keys), IMAGE_PAIR)


def _released(dataset: KittiFC, split: Path | None) -> Benchmark:
    """The corruptions and severities that the folder holds, and no others: nothing is made on the fly beside them."""
    keys = read_split(split, dataset.keys()) if split else dataset.keys()
    found = {name: dataset.severities(name) for name in IMAGE_PAIR if dataset.has_corrupted(name)}
    severities = tuple(level for level in SEVERITIES if all(level in levels for levels in found.values()))
    if not found or not severities:
        raise DataError(
            f"{dataset.root}: holds clean frames but no corruption with a severity common to all; expected folders "
            "such as fog_3/val/image_2"
        )
    return Benchmark(
        "kitti-fc", dataset, tuple(keys), tuple(found), severities, protocol={"frames": "released"}, closed=True
    )
