"""`gopro-fc`: all 24 corruptions on pairs with small displacements, without ground truth (paper Sec. 4.2 and
appendix)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...core.errors import DataError, UsageError
from ...corruptions import PAPER_ORDER
from .base import Benchmark
from .facts import BenchmarkFacts
from .released import warn_unless_whole

if TYPE_CHECKING:
    from ..datasets.gopro import GoProFCPrepared


class GoProFC:
    """GoPro-FC from a folder made by `robustflow prepare gopro-fc`, from the released folder, or from a single video
    file.
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
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """See `Definition.open`."""
        from ..datasets.gopro import GoProFCPrepared
        from ..datasets.released import GoProFCReleased
        from ..video.prepare_folder import prepare_video
        from ..video.prepared import is_prepared
        from .released import released

        if data is None:
            raise UsageError(f"gopro-fc needs data: give --data PATH ({GoProFC.facts.data})")
        if split is not None:
            raise UsageError("gopro-fc has no split: omit --split")
        if data.is_file():
            return _prepared(GoProFCPrepared(prepare_video(data)))
        if is_prepared(data):
            return _prepared(GoProFCPrepared(data))
        if (data / "clean").is_dir():
            dataset = GoProFCReleased(data)
            _check_sequences(dataset.keys())
            return released("gopro-fc", dataset, dataset.keys(), GoProFC.facts)
        if not data.exists():
            raise DataError(data, "no such file or folder; check the path")
        raise DataError(
            data,
            f"neither a prepared nor the released GoPro-FC; prepare it with robustflow prepare gopro-fc "
            f"--data {data} --output PREPARED, then give --data PREPARED",
        )


def _prepared(dataset: GoProFCPrepared) -> Benchmark:
    from ..video.prepared import slow_blur

    for clip in dataset.clips:
        span = slow_blur(clip)
        if span is not None:
            warnings.warn(
                f"{clip.name} has {float(clip.master.fps):g} frames per second, so object_motion_blur averages over up "
                f"to {float(span):.2f} s instead of 0.03 s as at the paper's 960 frames per second, and the readout "
                "of rolling_shutter takes equally long; prepare it with --factor to shorten both",
                stacklevel=2,
            )
    _check_sequences(dataset.keys())
    protocol = {"frames": "prepared", "clips": dataset.identity()}
    return Benchmark("gopro-fc", dataset, tuple(dataset.keys()), PAPER_ORDER, protocol=protocol, facts=GoProFC.facts)


def _check_sequences(keys: Sequence[str]) -> None:
    """Warn if these are not the sequences of GoPro-FC."""
    from ..video.prepare_folder import SEQUENCES

    warn_unless_whole("GoPro-FC", "sequence", SEQUENCES, list(dict.fromkeys(key.partition("/")[0] for key in keys)))
