"""`kitti-fc`: 20 corruptions on 80 of KITTI-2015's 200 training pairs (paper Sec. 4.2)."""

from __future__ import annotations

from pathlib import Path

from ..corruptions import IMAGE_PAIR
from ..datasets import load_dataset
from ..errors import UsageError
from .base import Benchmark
from .facts import BenchmarkFacts


class KittiFC:
    """KITTI-FC from the KITTI-2015 folder, corrupted on the fly, or from the released KITTI-FC folder as it is.

    The paper drew its 80 pairs without a seed and lists them only in its 44 GB download; here they come from a
    documented seed, or from `split`: a file, or "drive-disjoint", whose pairs share no drive with the others. All pairs
    of a folder with fewer than 200 are evaluated.
    """

    facts = BenchmarkFacts(
        title="KITTI-FC",
        description="80 pairs of driving under 20 corruptions.",
        data="the KITTI-2015 folder, which holds training/, or the released KITTI-FC, which holds clean/",
        published=True,
        paper_corruptions=IMAGE_PAIR,
        paper_pairs=80,
        training_set="kitti2015",
        same_domain=("kitti2012", "kitti-raw"),
    )

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """See `Definition.open`."""
        from ..datasets.kitti_fc_released import KittiFCReleased
        from ..datasets.split import kitti_split, selected
        from .released import released

        if data is None:
            raise UsageError("kitti-fc needs the KITTI-2015 folder: give --data PATH (the folder that holds training/)")
        if (data / "clean").is_dir():
            files = KittiFCReleased(data)
            keys = selected(split, files.keys(), files.name) if split else files.keys()
            return released("kitti-fc", files, keys, KittiFC.facts)
        dataset = load_dataset("kitti2015", data)
        keys = selected(split, dataset.keys(), dataset.name) if split else kitti_split(dataset.keys()).evaluation
        return Benchmark("kitti-fc", dataset, tuple(keys), IMAGE_PAIR, facts=KittiFC.facts)
