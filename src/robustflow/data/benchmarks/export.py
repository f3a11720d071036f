"""Write a benchmark's frames as files, in the layout in which KITTI-FC was released.

clean/val/image_2/000010_10.png, 000010_11.png      <corruption>_<severity>/val/image_2/...
clean/val/flow_occ/000010_10.png                    clean/val/flow_noc/000010_10.png if occlusion is known
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...core.errors import DataError, RunError
from ...core.files import make_folder, write_json
from ...core.types import Frame, Sample
from ...corruptions import corrupt_clip, load_corruption
from ...corruptions.api import STREAM_VERSION, user_sources
from ...corruptions.scale import calibration_digest
from ...media.flow import write_flow
from ...media.images import read_image, write_image
from ..datasets.released import DISK_NAMES
from .benchmark import Benchmark
from .facts import NON_OCCLUDED
from .paper import EXPORT_FILE, export_settings


@dataclass(frozen=True)
class Written:
    """Progress report: one sample under one condition is on disk; `fresh` is False if an earlier call wrote it."""

    key: str
    condition: str
    fresh: bool


def export(
    benchmark: Benchmark,
    output: Path,
    seed: int = 0,
    variant: str = "default",
    severity_scale: str = "paper",
) -> Iterator[Written]:
    scale = {"severity_scale": f"calibrated {calibration_digest()}"} if severity_scale == "calibrated" else {}
    corruptions = [load_corruption(name, variant, severity_scale, benchmark.classes) for name in benchmark.corruptions]
    settings = {"benchmark": benchmark.name, "seed": seed, "variant": variant, "streams": STREAM_VERSION}
    depths = benchmark.depth_to_read()
    own = {"depth": benchmark.own_depth.digest} if benchmark.own_depth is not None else {}
    truth = NON_OCCLUDED if NON_OCCLUDED.items() <= benchmark.protocol.items() else {}
    if nested := [key for key in benchmark.keys if "/" in key or key.startswith(".")]:
        raise DataError(nested[0], "the KITTI layout has no subfolders, so a sample of this name cannot be written")
    _claim(output, settings | scale | own | truth | user_sources(corruptions, variant))
    _check_existing_frames(output, benchmark)
    for key in benchmark.keys:
        sample = benchmark.dataset.load(key)
        fresh = _write_frames(output / "clean" / "val", key, partial(iter, sample.frames))
        scene = depths.depth(sample) if depths is not None else None
        _write_truth(output / "clean" / "val", sample)
        yield Written(key, "clean", fresh)
        for corruption, condition in zip(corruptions, benchmark.conditions, strict=True):
            for severity in condition.levels(benchmark.severities, severity_scale):
                folder = f"{DISK_NAMES.get(corruption.name, corruption.name)}_{severity}"
                make = partial(corrupt_clip, sample.frames, corruption, severity, seed, key, depth=scene)
                fresh = _write_frames(output / folder / "val", key, make)
                yield Written(key, folder, fresh)


def _frame_paths(folder: Path, key: str) -> list[Path]:
    return [folder / "image_2" / f"{key}_{10 + index}.png" for index in range(2)]


def _write_frames(folder: Path, key: str, make: Callable[[], Iterator[Frame]]) -> bool:
    paths = _frame_paths(folder, key)
    if all(path.exists() for path in paths):
        return False
    make_folder(folder / "image_2")
    for path, frame in zip(paths, make(), strict=False):
        write_image(path, frame)
    return True


def _write_truth(folder: Path, sample: Sample) -> None:
    if sample.flow is None or sample.valid is None:
        return
    maps = {"flow_occ": sample.valid}
    if sample.occluded is not None:
        maps["flow_noc"] = sample.valid & ~sample.occluded
    for name, valid in maps.items():
        path = folder / name / f"{sample.key}_10.png"
        if not path.exists():
            make_folder(path.parent)
            write_flow(path, sample.flow, valid)


def _claim(output: Path, settings: dict[str, object]) -> None:
    on_disk = export_settings(output)
    if on_disk is None and (output / "clean").exists():
        raise RunError(output, "contains frames that were not exported from here; choose another --output")
    if on_disk is not None and on_disk != settings:
        raise RunError(output, f"contains a different export ({EXPORT_FILE}: {on_disk}); choose another --output")
    make_folder(output)
    write_json(output / EXPORT_FILE, settings)


def _check_existing_frames(output: Path, benchmark: Benchmark) -> None:
    for key in benchmark.keys:
        paths = _frame_paths(output / "clean" / "val", key)
        if not any(path.exists() for path in paths):
            continue
        for path, frame in zip(paths, benchmark.dataset.load(key).frames, strict=False):
            if path.exists() and not np.array_equal(read_image(path), frame):
                raise RunError(output, f"contains different frames of sample '{key}'; choose another --output")
