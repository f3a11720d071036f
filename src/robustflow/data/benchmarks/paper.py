"""The benchmarks `demo`, `kitti-fc` and `gopro-fc`, from uncorrupted data or from a folder of released frames.

A result carries the name of its benchmark, so data that are not all of KITTI-FC or GoPro-FC cause a warning.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Collection, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.errors import DataError, UsageError
from ...core.files import read_bounded
from ...core.text import first_of, plain
from ...corruptions import IMAGE_PAIR, PAPER_ORDER, SEVERITIES
from ...corruptions.registry import FURTHER, SHIPPED
from ...corruptions.weather.frost import GeneratedFrost
from ..datasets import load_dataset
from .benchmark import Benchmark
from .facts import EXPORTED, BenchmarkFacts, QuickSubset

if TYPE_CHECKING:
    from ..datasets.gopro_fc import GoProFCPrepared
    from ..datasets.kitti import KittiPairs
    from ..datasets.released import ReleasedPairs

DEMO_CLASSES = {"frost": GeneratedFrost}
"""Corruptions that are replaced on the demo pair to avoid a download."""

EXPORT_FILE = "export.json"
"""Name of the file in which `export` records the settings of the frames that it wrote."""
_RECORDED = ("seed", "variant", "severity_scale")
_LARGEST = 1 << 20
_PAIRS = 80
_MOST_NAMED = 20


class Demo:
    """One real pair with ground truth, the Middlebury 2014 motorcycle (741 x 500), under the corruptions of KITTI-FC;
    its ground truth is disparity, so all motion is horizontal.
    """

    facts = BenchmarkFacts(
        title="demo",
        description="One real pair with ground truth that comes with the installation.",
        training_set="middlebury",
    )

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        if data is not None or split is not None:
            raise UsageError("demo", "has its own pair: omit --split, or give --data and --benchmark")
        dataset = load_dataset("motorcycle", None)
        return Benchmark("demo", dataset, tuple(dataset.keys()), IMAGE_PAIR, classes=DEMO_CLASSES, facts=Demo.facts)


class KittiFC:
    """20 corruptions on 80 of KITTI 2015's 200 training pairs (paper Sec. 4.2), corrupted on the fly from the KITTI
    2015 folder, or read from the released KITTI-FC.
    """

    facts = BenchmarkFacts(
        title="KITTI-FC",
        description="80 driving pairs under 20 corruptions.",
        data="the KITTI-2015 folder, which contains training/, or the released KITTI-FC, which contains clean/",
        published=True,
        paper_corruptions=IMAGE_PAIR,
        paper_pairs=_PAIRS,
        lowest_ood_clean_epe=3.78,
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
    def members(keys: Collection[str]) -> set[str]:
        """Return which pairs of KITTI are of the benchmark."""
        from ..datasets.split import KITTI_KEYS, kitti_split

        return {*keys} & {*kitti_split(KITTI_KEYS).evaluation}

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        from ..datasets.kitti import Kitti2015
        from ..datasets.released import KittiFCReleased
        from ..datasets.split import KITTI_KEYS, kitti_split, selected

        if data is None:
            raise UsageError("--data", f"kitti-fc needs {KittiFC.facts.data}")
        dataset = KittiFCReleased(data) if (data / "clean").is_dir() else Kitti2015(data)
        _check_truth(dataset)
        keys = selected(split, dataset.keys(), dataset.name) if split else dataset.keys()
        if isinstance(dataset, KittiFCReleased):
            if split is None and len(keys) < _PAIRS:
                lacks = f"{_PAIRS - len(keys)} of KITTI-FC's {_PAIRS} pairs are not in {dataset.folder}"
                warnings.warn(f"{lacks}; the result is not a KITTI-FC result", stacklevel=4)
            return released("kitti-fc", dataset, keys, KittiFC.facts)
        if split is None:
            keys, wanted = (kitti_split(every).evaluation for every in (keys, KITTI_KEYS))
            _warn_unless_whole("KITTI-FC", "pair", wanted, keys)
        return Benchmark("kitti-fc", dataset, tuple(keys), IMAGE_PAIR, facts=KittiFC.facts)


def _check_truth(dataset: KittiPairs) -> None:
    """Raise unless the ground truth covers all pixels, including occluded ones, as KITTI-FC requires."""
    if dataset.non_occluded:
        instead = "--benchmark kitti2015, which labels the results by flow_noc/"
        raise DataError(dataset.folder, f"no flow_occ/, which KITTI-FC needs: unpack it, or use {instead}")


class GoProFC:
    """All 24 corruptions on pairs with small displacements, without ground truth (paper Sec. 4.2 and appendix), from a
    folder made by `robustflow prepare gopro-fc`, from the released folder, or from a single video file.
    """

    facts = BenchmarkFacts(
        title="GoPro-FC",
        description="Small displacements in hand-held recordings under all 24 corruptions, without ground truth.",
        data="a folder made by robustflow prepare gopro-fc, the released GoPro-FC, or a video file",
        has_flow=False,
        published=True,
        paper_corruptions=PAPER_ORDER,
        paper_pairs=5 * 135,
        training_set="gopro",
    )

    @staticmethod
    def members(keys: Collection[str]) -> set[str]:
        """Return which pairs are of the benchmark's sequences."""
        from ..video.prepare_folder import SEQUENCES

        return {key for key in keys if key.partition("/")[0] in SEQUENCES}

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        from ..datasets.gopro_fc import GoProFCPrepared
        from ..datasets.released import GoProFCReleased
        from ..video.prepare_folder import SEQUENCES, prepare_video
        from ..video.prepared import FOLDER_MANIFEST

        if data is None:
            raise UsageError("--data", f"gopro-fc needs {GoProFC.facts.data}")
        if split is not None:
            raise UsageError("--split", "gopro-fc has no split; omit it")
        if data.is_file() or (data / FOLDER_MANIFEST).is_file():
            benchmark = _prepared(GoProFCPrepared(prepare_video(data) if data.is_file() else data))
        elif (data / "clean").is_dir():
            files = GoProFCReleased(data)
            benchmark = released("gopro-fc", files, files.keys(), GoProFC.facts)
        elif data.exists():
            how = f"robustflow prepare gopro-fc --data {data} --output PREPARED, then give --data PREPARED"
            raise DataError(data, f"neither a prepared nor the released GoPro-FC; prepare it with {how}")
        else:
            raise DataError(data, "no such file or folder; check the path")
        sequences = list(dict.fromkeys(key.partition("/")[0] for key in benchmark.keys))
        _warn_unless_whole("GoPro-FC", "sequence", list(SEQUENCES), sequences)
        return benchmark


def _prepared(dataset: GoProFCPrepared) -> Benchmark:
    from ..video.prepared import REACH

    for clip in dataset.clips:
        span = (2 * REACH + 1) / clip.master.fps  # at the highest severity
        if span > Fraction(2 * REACH + 1, 960):
            rate = f"{clip.name} has {float(clip.master.fps):g} frames per second, so"
            blur = f"object_motion_blur and the readout of rolling_shutter take up to {float(span):.2f} s, not 0.03 s"
            warnings.warn(f"{rate} {blur} as in the paper; prepare it with --factor to shorten both", stacklevel=2)
    protocol = {"frames": "prepared", "clips": dataset.identity()}
    return Benchmark("gopro-fc", dataset, tuple(dataset.keys()), PAPER_ORDER, protocol=protocol, facts=GoProFC.facts)


def released(name: str, dataset: ReleasedPairs, keys: list[str], facts: BenchmarkFacts) -> Benchmark:
    """Return a benchmark with only the corruptions and severities in the folder; no corruption is computed on the fly.
    Its protocol distinguishes the authors' frames, of which only the paper's corruptions are read, from an export by
    this package.
    """
    settings = export_settings(dataset.root)
    source = (settings or {}).get("benchmark", name)
    if source != name:
        raise DataError(dataset.root, f"frames exported from {plain(str(source))}, so its results are not {name}'s")
    flat = [
        corruption for corruption in SHIPPED if corruption not in FURTHER["depth"]
    ]  # an export does not contain depth
    found = {one: dataset.severities(one) for one in (PAPER_ORDER if settings is None else flat)}
    found = {corruption: levels for corruption, levels in found.items() if levels}
    severities = tuple(level for level in SEVERITIES if all(level in levels for levels in found.values()))
    if not found or not severities:
        raise DataError(dataset.root, "no severity that all corruptions share; folders are like fog_3")
    protocol: dict[str, Any] = {"frames": "released"}
    if settings is not None:
        protocol = EXPORTED | {key: settings[key] for key in _RECORDED if isinstance(settings.get(key), str | int)}
    return Benchmark(name, dataset, tuple(keys), tuple(found), severities, protocol=protocol, closed=True, facts=facts)


def export_settings(folder: Path) -> dict[str, Any] | None:
    """Return the settings with which this package wrote the frames in a folder: empty if they cannot be read, None for
    a folder that was written by others."""
    record = folder / EXPORT_FILE
    if not record.is_file():
        return None
    try:
        settings = json.loads(read_bounded(record, _LARGEST, "restore it"))
    except (DataError, ValueError, RecursionError):
        return {}
    return settings if isinstance(settings, dict) else {}


def _warn_unless_whole(title: str, noun: str, wanted: Sequence[str], evaluated: Sequence[str]) -> None:
    """Warn if the evaluated pairs or sequences are not those of a benchmark."""
    missing, others = [name for name in wanted if name not in set(evaluated)], len(set(evaluated) - set(wanted))
    if missing or others:
        names = f" ({first_of(missing, _MOST_NAMED)})" if missing else ""
        lacks = f"{len(missing)} of {title}'s {len(wanted)} {noun}s are missing{names}"
        what = f"{lacks}, and {others} of the {len(evaluated)} evaluated are not part of it"
        warnings.warn(f"{what}; the result is not a {title} result", stacklevel=4)
