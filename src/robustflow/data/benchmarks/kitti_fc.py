"""`kitti-fc`: 20 corruptions on 80 of KITTI-2015's 200 training pairs (paper Sec. 4.2)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...core.errors import DataError, UsageError
from ...corruptions import IMAGE_PAIR
from .base import Benchmark
from .facts import BenchmarkFacts, QuickSubset
from .released import warn_incomplete, warn_unless_whole

if TYPE_CHECKING:
    from ..datasets.kitti import KittiPairs

_PAIRS = 80


class KittiFC:
    """KITTI-FC from the KITTI-2015 folder, corrupted on the fly, or from the released KITTI-FC folder."""

    facts = BenchmarkFacts(
        title="KITTI-FC",
        description="80 driving pairs under 20 corruptions.",
        data="the KITTI-2015 folder, which contains training/, or the released KITTI-FC, which contains clean/",
        published=True,
        paper_corruptions=IMAGE_PAIR,
        paper_pairs=_PAIRS,
        training_set="kitti2015",
        same_domain=("kitti2012", "kitti-raw"),
        quick=QuickSubset(
            corruptions=(
                *("jpeg_compression", "low_light", "over_exposure", "under_exposure", "spatter"),
                *("frost", "snow", "shot_noise", "impulse_noise", "gaussian_blur"),
                *("defocus_blur", "glass_blur", "camera_motion_blur", "psf_blur"),
            ),
            severities=(2,),
            tau=0.90,
            tau_of_others=0.86,
            published=29,
            measured=14,
        ),
    )

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """See `Definition.open`."""
        from ..datasets.kitti import Kitti2015
        from ..datasets.released import KittiFCReleased
        from ..datasets.split import KITTI_KEYS, kitti_split, selected
        from .released import released

        if data is None:
            raise UsageError(
                "kitti-fc needs the KITTI-2015 folder: give --data PATH (the folder that contains training/)"
            )
        if (data / "clean").is_dir():
            files = KittiFCReleased(data)
            _check_truth(files)
            keys = selected(split, files.keys(), files.name) if split else files.keys()
            if split is None and len(keys) < _PAIRS:
                warn_incomplete(
                    "KITTI-FC", f"{_PAIRS - len(keys)} of KITTI-FC's {_PAIRS} pairs are not in {files.folder}"
                )
            return released("kitti-fc", files, keys, KittiFC.facts)
        dataset = Kitti2015(data)
        _check_truth(dataset)
        if split is None:
            keys = kitti_split(dataset.keys()).evaluation
            split_keys = kitti_split(KITTI_KEYS).evaluation
            warn_unless_whole("KITTI-FC", "pair", split_keys, keys, ": unpack all 200 pairs to get one")
        else:
            keys = selected(split, dataset.keys(), dataset.name)
        return Benchmark("kitti-fc", dataset, tuple(keys), IMAGE_PAIR, facts=KittiFC.facts)


def _check_truth(dataset: KittiPairs) -> None:
    """Raise unless the ground truth covers all pixels, including occluded ones, as KITTI-FC requires."""
    if dataset.non_occluded:
        raise DataError(
            dataset.folder,
            "no flow_occ/, on which KITTI-FC is measured: unpack data_scene_flow.zip, or measure "
            "on flow_noc/ with --benchmark kitti2015, which labels the results accordingly",
        )
