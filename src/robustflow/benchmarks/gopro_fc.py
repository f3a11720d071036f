"""`gopro-fc`: all 24 corruptions on small displacements, without ground truth (paper Sec. 4.2 and appendix)."""

from __future__ import annotations

import warnings
from pathlib import Path

from ..corruptions import PAPER_ORDER
from ..datasets.gopro_fc import GoProFC, is_prepared, prepare_video, slow_blur
from ..datasets.gopro_fc_released import GoProFCReleased
from ..errors import DataError, UsageError
from .base import Benchmark
from .released import released


def gopro_fc(data: Path | None, split: Path | None) -> Benchmark:
    """GoPro-FC from a folder that `robustflow prepare gopro-fc` made, from the released one, or from one video file.

    A video is taken as it is: no interpolation, key frames 1/30 s apart, prepared once in the user's cache folder.

    Raises:
        UsageError: no data, or a split (it has none).
        DataError: none of the three.
    """
    if data is None:
        raise UsageError(
            "gopro-fc needs data: give --data PATH (a folder made by robustflow prepare gopro-fc, the released "
            "GoPro-FC, or a video file)"
        )
    if split is not None:
        raise UsageError("gopro-fc has no split: leave out --split")
    if data.is_file():
        return _prepared(GoProFC(prepare_video(data)))
    if is_prepared(data):
        return _prepared(GoProFC(data))
    if (data / "clean").is_dir():
        dataset = GoProFCReleased(data)
        return released("gopro-fc", dataset, dataset.keys())
    raise DataError(
        f"{data}: neither a prepared nor the released GoPro-FC; make it with robustflow prepare gopro-fc "
        f"--data {data} --output PREPARED, then give --data PREPARED"
    )


def _prepared(dataset: GoProFC) -> Benchmark:
    for clip in dataset.clips:
        span = slow_blur(clip)
        if span is not None:
            warnings.warn(
                f"{clip.name} has {float(clip.master.fps):g} frames per second, so object_motion_blur averages over up "
                f"to {float(span):.2f} s where the paper's 960 make it 0.03 s; prepare it with --factor for less",
                stacklevel=2,
            )
    protocol = {"frames": "prepared", "clips": dataset.identity()}
    return Benchmark("gopro-fc", dataset, tuple(dataset.keys()), PAPER_ORDER, protocol=protocol)
