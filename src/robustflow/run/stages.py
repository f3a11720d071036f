"""Two of the three stages of a cell: prepare its frames, and predict their flow. The third, measuring, is in
`computation`, which runs all of them in sequence."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import cv2
import numpy as np

from ..core.errors import DataError, RunError, UsageError, first_line
from ..core.files import digest_of_bytes, quick_digest_of_bytes, write_bytes
from ..core.types import Flow, Frame, Sample, SceneDepth
from ..corruptions.api import corrupt_clip
from ..corruptions.corruption import Corruption
from ..corruptions.registry import SHIPPED
from ..data.datasets.clips import ContextFrames
from ..data.datasets.dataset import Clips, PreCorrupted
from ..data.datasets.own_dataset import load_checked
from ..media.images import jpeg_bytes, shrunk
from ..metrics.regions import Regions
from ..metrics.rows import CLEAN
from ..models.calls import describe_cell, describe_cells, predict_batch_checked, predict_checked, predict_clip_checked
from ..models.confidence import (
    FORWARD_BACKWARD,
    OF_MODEL,
    Answer,
    ConfidentModel,
    flow_of,
    predict_with_confidence_checked,
    with_back,
    with_spread,
)
from ..models.protocols import AnyModel, BatchedFlowModel, ClipModel, FlowLookup, FlowModel, place_of_pair
from .manifest import Cell
from .plan import Job

SLIDER_WIDTH = 384
"""Maximum width of a slider picture in pixels, in the folder and on pages."""

Seconds = defaultdict[str, float]
"""Seconds by kind of work: "load", "corrupt", "attack", "predict", "measure", and one entry per attack, such as "attack
pgd", whose time is included in "attack"."""


@contextmanager
def timed(seconds: Seconds, kind: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[kind] += time.perf_counter() - start


@contextmanager
def memory_errors_named(
    doing: str, smaller: str = "fewer --workers, a smaller --batch-size or frames"
) -> Iterator[None]:
    """Within the block, convert NumPy's and OpenCV's errors about lack of memory."""
    try:
        yield
    except (MemoryError, cv2.error) as error:
        if isinstance(error, cv2.error) and getattr(error, "code", None) != cv2.Error.StsNoMem:
            raise
        raise RunError(doing, f"not enough memory ({first_line(error)}); try {smaller}") from error


def frames_digest(frames: tuple[Frame, ...]) -> str:
    """Return a digest of the bytes and sizes of frames, in row order, as 32 hexadecimal digits."""
    parts: list[bytes | memoryview] = []
    for frame in frames:
        parts += [str(frame.shape).encode(), np.ascontiguousarray(frame).reshape(-1).data]
    return quick_digest_of_bytes(*parts)


@dataclass
class OpenSample:
    """A sample in progress, with values that are computed once per sample."""

    sample: Sample
    regions: Regions | None
    clean: Answer | None = None
    """The answer to the clean frames, once it is known."""
    requested: bool = False
    """Whether the clean flow is known or has been requested."""

    @property
    def clean_flow(self) -> Flow:
        assert self.clean is not None
        return flow_of(self.clean)


@dataclass(frozen=True)
class PredictionRequest:
    """A request for the flow of one cell."""

    cell: Cell
    frames: tuple[Frame, ...]
    """The frames of all draws."""
    index: int | None = None
    """The place of the pair among the frames of a multi-frame model."""
    draws: int = 1
    again: bool = False
    """Whether the cell has been predicted before, to see whether the flow is the same; this time is not counted."""


class FrameStage:
    """Read samples, corrupt their frames, and put them in the order that the model expects."""

    def __init__(self, job: Job, seconds: Seconds) -> None:
        self._job = job
        self._dataset = job.dataset
        self._seconds = seconds
        self._context = None
        if job.window is not None:
            assert isinstance(job.dataset, Clips)
            self._context = ContextFrames(job.dataset, job.window)
        self._repeated: set[str] = set()
        """The user's corruptions and stacks that are known to return the same frames on every call."""
        self._last_depth: tuple[str, SceneDepth] | None = None

    def load(self, key: str) -> OpenSample:
        with timed(self._seconds, "load"):
            sample = load_checked(self._dataset, key)
            if self._context is not None:
                sample = self._context.add(sample)
            if sample.valid is not None and not sample.valid.any():
                raise DataError(
                    f"sample '{key}'",
                    "its ground truth marks no pixel as valid, so no error can be measured; exclude it with --split, "
                    "or restore the flow file",
                )
            regions = Regions.of(sample) if sample.flow is not None else None
            return OpenSample(sample, regions)

    def corrupt(self, sample: Sample, name: str, severity: int) -> tuple[Frame, ...]:
        """Return the frames of a sample under the first draw of a corruption, in the sample's order."""
        frames = self._corrupted(sample, name, severity, self._job.frames.seed)
        if self._job.pictures is not None:
            with suppress(DataError):  # a picture that cannot be written is made later
                path = picture_path(self._job.pictures, name, severity)
                write_bytes(path, slider_picture(frames, sample.frames), durable=False)
        return frames

    def request(self, sample: Sample, cell: Cell, frames: tuple[Frame, ...]) -> PredictionRequest:
        """Return the request for the flow of a cell. Clean frames and attacks have one draw, which is repeated."""
        key, name, severity = cell
        draws = [frames]
        seed = self._job.frames.seed
        for other in range(seed + 1, seed + self._job.measuring.draws):
            draws.append(frames if name == CLEAN else self._corrupted(sample, name, severity, other))
        place = None
        if self._context is not None:
            draws = [self._context.in_order(key, each) for each in draws]
            place = place_of_pair(self._context.offsets(key))
        return PredictionRequest(cell, tuple(chain.from_iterable(draws)), place, len(draws))

    def _corrupted(self, sample: Sample, name: str, severity: int, seed: int) -> tuple[Frame, ...]:
        with memory_errors_named(describe_cell(sample.key, name, severity)), timed(self._seconds, "corrupt"):
            # precomputed corrupted frames have the paper's severities
            paper = self._job.frames.severity_scale == "paper"
            if paper and isinstance(self._dataset, PreCorrupted) and self._dataset.has_corrupted(name):
                made = self._dataset if self._context is None else self._context
                return made.corrupted(sample.key, name, severity)
            corruption = self._job.corruptions[name]
            frames = self._applied(sample, corruption, severity, seed)
            if name not in SHIPPED and name not in self._repeated:
                self._repeated.add(name)
                again = self._applied(sample, corruption, severity, seed)
                if not all(map(np.array_equal, frames, again)):
                    raise UsageError(
                        name,
                        "this corruption returns different frames on every call, so the results could not be repeated: "
                        "draw all random numbers from `rng`",
                    )
            return frames

    def _applied(self, sample: Sample, corruption: Corruption, severity: int, seed: int) -> tuple[Frame, ...]:
        if self._context is not None:
            return self._context.corrupt(sample, corruption, severity, seed)
        depth = self._depth(sample) if corruption.needs_depth else None
        return tuple(corrupt_clip(sample.frames, corruption, severity, seed, sample.key, depth=depth))

    def _depth(self, sample: Sample) -> SceneDepth | None:
        """Return the depth of a sample; the depth of the latest sample is cached."""
        if self._job.depth is None:
            return None
        if self._last_depth is None or self._last_depth[0] != sample.key:
            self._last_depth = None  # released before the next depth is read
            self._last_depth = sample.key, self._job.depth.depth(sample)
        return self._last_depth[1]


def slider_picture(frames: tuple[Frame, ...], clean: tuple[Frame, ...]) -> bytes:
    """Return a JPEG of the first frame that a corruption changed: over_exposure changes only one of the two."""
    changed = [frame for frame, before in zip(frames, clean, strict=False) if not np.array_equal(frame, before)]
    return jpeg_bytes(shrunk((changed or frames)[0], SLIDER_WIDTH))


def picture_path(folder: Path, corruption: str, severity: int) -> Path:
    """Return where a worker stores the slider picture of a cell."""
    return folder / f"{digest_of_bytes(f'{corruption} {severity}'.encode(), size=16)}.jpg"


class PredictStage:
    """Call a model, and check that it returns flows."""

    def __init__(self, model: AnyModel, confidence: str | None, on_predict: Callable[[str | None], None]) -> None:
        self._model = model
        self._confidence = confidence
        self._on_predict = on_predict

    def predict(self, requests: Sequence[PredictionRequest]) -> tuple[list[Answer], float]:
        """Predict the flow of requests, in one call if the model supports batches; a single request uses `predict`.
        Return also the seconds that it took."""
        start = time.perf_counter()
        if requests[0].draws > 1:
            answers = list(map(self._predict_draws, requests))
        elif self._confidence == OF_MODEL:
            answers = list(map(self._predict_with_confidence, requests))
        else:
            answers = self._flows(requests)
        if self._confidence == FORWARD_BACKWARD:
            answers = list(map(with_back, answers, self._flows_back(requests, answers)))
        return answers, 0.0 if requests[0].again else time.perf_counter() - start

    @contextmanager
    def _announced(self, *requests: PredictionRequest) -> Iterator[None]:
        self._on_predict(describe_cells([request.cell for request in requests]))
        yield
        self._on_predict(None)

    def _predict_with_confidence(self, request: PredictionRequest) -> Answer:
        assert isinstance(self._model, ConfidentModel)
        with self._announced(request):
            return predict_with_confidence_checked(self._model, request.frames, describe_cell(*request.cell))

    def _predict_draws(self, request: PredictionRequest) -> Answer:
        """Return the flow of the first draw, with the spread over all; draws with equal frames are predicted once."""
        count = len(request.frames) // request.draws
        draws = [request.frames[start : start + count] for start in range(0, len(request.frames), count)]
        first = self._predict_once(replace(request, frames=draws[0]))
        flows = [
            first if all(map(np.array_equal, frames, draws[0])) else self._predict_once(replace(request, frames=frames))
            for frames in draws[1:]
        ]
        return with_spread([first, *flows])

    def _flows(self, requests: Sequence[PredictionRequest]) -> list[Flow]:
        if len(requests) > 1 and requests[0].index is None and isinstance(self._model, BatchedFlowModel):
            cells = [request.cell for request in requests]
            with self._announced(*requests):
                return predict_batch_checked(self._model, [request.frames for request in requests], cells)
        return [self._predict_once(request) for request in requests]

    def _flows_back(self, requests: Sequence[PredictionRequest], flows: Sequence[Flow]) -> list[Flow]:
        """Predict the flows from frame 2 to frame 1; if the frames are equal, the flow is already known."""
        known = [np.array_equal(request.frames[0], request.frames[1]) for request in requests]
        asked = [replace(one, frames=one.frames[1::-1]) for one, same in zip(requests, known, strict=True) if not same]
        back = iter(self._flows(asked))
        return [flow if same else next(back) for flow, same in zip(flows, known, strict=True)]

    def _predict_once(self, request: PredictionRequest) -> Flow:
        with self._announced(request):
            if request.index is not None:
                assert isinstance(self._model, ClipModel)
                return predict_clip_checked(self._model, request.frames, request.index, *request.cell)
            assert isinstance(self._model, FlowModel | FlowLookup)
            return predict_checked(self._model, request.frames, *request.cell)
