"""Hash the frames given to a model, to check that runs, records and data have the same frames. Name the cell for
which there was not enough memory. The first stage of a cell: read its sample, corrupt the frames, and put them
in the order that the model expects.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain

import cv2
import numpy as np

from ..core.errors import DataError, RunError, UsageError, first_line
from ..core.files import quick_digest_of_bytes
from ..core.types import Frame, Sample, SceneDepth
from ..corruptions.api import corrupt_clip, load_corruption
from ..corruptions.base import Corruption
from ..corruptions.own import register_custom
from ..corruptions.registry import SHIPPED
from ..data.datasets.base import Clips, Dataset, PreCorrupted
from ..data.datasets.clips import ContextFrames
from ..data.datasets.own import load_checked
from ..metrics.regions import Regions
from ..metrics.rows import CLEAN
from ..models.base import describe_cell, place_of_pair
from .cells import Cell
from .example_cells import keep_picture
from .plan import RunOptions
from .predict_stage import PredictionRequest
from .seconds import Seconds, timed


def frames_digest(frames: tuple[Frame, ...]) -> str:
    """Return a digest of the bytes and sizes of frames, as 32 hexadecimal digits."""
    return quick_digest_of_bytes(*_content(frames))


def _content(frames: tuple[Frame, ...]) -> Iterator[bytes | memoryview]:
    """Yield the size and the bytes of each frame, in row order and without copying."""
    for frame in frames:
        yield str(frame.shape).encode()
        if frame.size:
            yield np.ascontiguousarray(frame).data.cast("B")


@contextmanager
def memory_errors_named(doing: str) -> Iterator[None]:
    """Within the block, convert NumPy's and OpenCV's errors about lack of memory."""
    try:
        yield
    except (MemoryError, cv2.error) as error:
        if isinstance(error, cv2.error) and getattr(error, "code", None) != cv2.Error.StsNoMem:
            raise
        raise RunError(
            f"not enough memory to compute {doing} ({first_line(error)}); try fewer --workers, a smaller --batch-size "
            "or smaller frames"
        ) from error


@dataclass(frozen=True)
class Loaded:
    """A sample, with values that are computed once per sample."""

    sample: Sample
    regions: Regions | None
    clean_flow_key: str

    def under(self, truth: str) -> Loaded:
        """Return the sample with what a corruption leaves of its ground truth (`Corruption.truth`)."""
        return self if truth == "unchanged" else replace(self, sample=self.sample.without_truth(), regions=None)


class FrameStage:
    """Prepare the frames of cells."""

    def __init__(self, dataset: Dataset, options: RunOptions, seconds: Seconds) -> None:
        self._dataset = dataset
        self._options = options
        self._seconds = seconds
        self._context = None
        if options.window is not None:
            assert isinstance(dataset, Clips)
            self._context = ContextFrames(dataset, options.window)
        for made in options.own:
            register_custom(made)
        self._corruptions: dict[str, Corruption] = {}
        self._repeated: set[str] = set()
        """The user's corruptions and stacks that are known to return the same frames on every call."""
        self._last_depth: tuple[str, SceneDepth] | None = None

    def load(self, key: str) -> Loaded:
        """Read a sample."""
        with timed(self._seconds, "load"):
            sample = load_checked(self._dataset, key)
            if self._context is not None:
                sample = self._context.add(sample)
            if sample.valid is not None and not sample.valid.any():
                raise DataError(
                    f"sample '{key}': its ground truth marks no pixel as valid, so no error can be measured; "
                    "exclude it with --split, or restore the flow file"
                )
            regions = Regions.of(sample) if sample.flow is not None else None
            return Loaded(sample, regions, f"{self._options.run} {key} {frames_digest(sample.frames)}")

    def corrupt(self, sample: Sample, name: str, severity: int) -> tuple[Frame, ...]:
        """Return the frames of a sample under the first draw of a corruption, in the sample's order."""
        frames = self._corrupted(sample, name, severity, self._options.frames.seed)
        if self._options.pictures is not None:
            keep_picture(self._options.pictures, frames, sample.frames, name, severity)
        return frames

    def _corrupted(self, sample: Sample, name: str, severity: int, seed: int) -> tuple[Frame, ...]:
        with memory_errors_named(describe_cell(sample.key, name, severity)), timed(self._seconds, "corrupt"):
            paper = (
                self._options.frames.severity_scale == "paper"
            )  # precomputed corrupted frames have the paper's severities
            if paper and isinstance(self._dataset, PreCorrupted) and self._dataset.has_corrupted(name):
                made = self._dataset if self._context is None else self._context
                return made.corrupted(sample.key, name, severity)
            if name not in self._corruptions:
                self._corruptions[name] = load_corruption(
                    name, self._options.frames.variant, self._options.frames.severity_scale, self._options.classes
                )
            corruption = self._corruptions[name]
            frames = self._applied(sample, corruption, severity, seed)
            if name not in SHIPPED and name not in self._repeated:
                self._repeated.add(name)
                again = self._applied(sample, corruption, severity, seed)
                if not all(map(np.array_equal, frames, again)):
                    raise UsageError(
                        f"corruption '{name}' returns different frames on every call, so the results could not be "
                        "repeated: draw all random numbers from `rng`"
                    )
            return frames

    def _applied(self, sample: Sample, corruption: Corruption, severity: int, seed: int) -> tuple[Frame, ...]:
        common = self._options.frames.common_draws
        if self._context is not None:
            return self._context.corrupt(sample, corruption, severity, seed, common)
        depth = self._depth(sample) if corruption.needs_depth else None
        return tuple(
            corrupt_clip(sample.frames, corruption, severity, seed, sample.key, common_draws=common, depth=depth)
        )

    def _depth(self, sample: Sample) -> SceneDepth | None:
        """Return the depth of a sample; the depth of the latest sample is cached."""
        if self._options.depth is None:
            return None
        if self._last_depth is None or self._last_depth[0] != sample.key:
            self._last_depth = None  # released before the next depth is read
            self._last_depth = sample.key, self._options.depth.depth(sample)
        return self._last_depth[1]

    def request(self, sample: Sample, cell: Cell, frames: tuple[Frame, ...]) -> PredictionRequest:
        """Return the request for the flow of a cell, with the frames of all draws of its corruption in the order that
        the model expects. Clean frames and attacks have one draw, which is repeated."""
        key, name, severity = cell
        draws = [frames]
        for seed in range(self._options.frames.seed + 1, self._options.frames.seed + self._options.measuring.draws):
            draws.append(frames if name == CLEAN else self._corrupted(sample, name, severity, seed))
        if self._context is None:
            return PredictionRequest(cell, tuple(chain.from_iterable(draws)), draws=len(draws))
        ordered = [self._context.in_order(key, each) for each in draws]
        place = place_of_pair(self._context.offsets(key))
        return PredictionRequest(cell, tuple(chain.from_iterable(ordered)), place, len(draws))
