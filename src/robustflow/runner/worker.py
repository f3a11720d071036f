"""Compute one unit: corrupt, predict, measure. The same code in every engine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..corruptions.api import corrupt_clip, load_corruption
from ..corruptions.base import Corruption
from ..corruptions.own import adopt
from ..datasets.base import Clips, Dataset, PreCorrupted
from ..datasets.context_frames import ContextFrames
from ..digest import digest_of_bytes
from ..errors import DataError, ModelError
from ..metrics.regions import Regions
from ..metrics.rows import CLEAN, measure
from ..models.base import (
    AnyModel,
    BatchedFlowModel,
    ClipModel,
    FlowLookup,
    FlowModel,
    place,
    predict_batch_checked,
    predict_checked,
    predict_clip_checked,
)
from ..models.window import place_of_pair
from ..runs.clean_flows import read_clean, write_clean
from ..runs.plan import RunOptions, Unit
from ..sample import Flow, Frame, Sample
from .kept_rows import check_same_data, check_same_model
from .slider_pictures import keep_picture


@dataclass
class _Loaded:
    sample: Sample
    regions: Regions | None
    clean: Flow


@dataclass(frozen=True)
class View:
    """One cell as a person looks at it: what the model was given, what it answered, and the row that was measured.

    Attributes:
        sample: with the clean frames.
        frames: the corrupted ones, RGB uint8 (H, W, 3); the first two are the pair.
        flow, clean_flow: float32 (H, W, 2), pixels.
        row: see `robustflow.metrics.rows`.
    """

    sample: Sample
    frames: tuple[Frame, ...]
    flow: Flow
    clean_flow: Flow
    row: dict[str, Any]


class Worker:
    """Computes units of one run, keeping the last sample and its clean flow at hand.

    Args:
        clean_path: where a sample's clean flow is kept between units, so that it is computed once per sample.
        on_predict: called with what is being predicted before each prediction and with None after it; the process
            engine watches a model's time this way.
        batch_size: severities of a unit that are predicted in one call, where the model can.
        kept: clean rows measured earlier, by sample (see `kept_rows`); a sample of which there is one is refused
            where its frames, its ground truth or the model's prediction are not what they were.
    """

    def __init__(
        self,
        dataset: Dataset,
        model: AnyModel,
        options: RunOptions,
        clean_path: Callable[[str], Path],
        on_predict: Callable[[str | None], None] = lambda what: None,
        batch_size: int = 1,
        kept: Mapping[str, dict[str, Any]] | None = None,
    ) -> None:
        self._dataset = dataset
        self._model = model
        self._options = options
        self._clean_path = clean_path
        self._on_predict = on_predict
        self._batch_size = batch_size
        self._kept = kept or {}
        self._context = None
        if options.window is not None:
            assert isinstance(dataset, Clips)
            self._context = ContextFrames(dataset, options.window)
        for made in options.own:
            adopt(made)
        self._corruptions: dict[str, Corruption] = {}
        self._loaded: _Loaded | None = None
        self.seconds = {"load": 0.0, "corrupt": 0.0, "predict": 0.0, "measure": 0.0}

    def run(self, unit: Unit) -> list[dict[str, Any]]:
        """The rows of a unit, in the order of its severities."""
        loaded = self._load(unit.key)
        if unit.corruption == CLEAN:
            return [self._row(loaded, loaded.clean, loaded.sample.frames, CLEAN, 0)]
        rows = []
        for start in range(0, len(unit.severities), self._batch_size):
            severities = unit.severities[start : start + self._batch_size]
            corrupted = [self._corrupt(loaded.sample, unit.corruption, severity) for severity in severities]
            flows = self._predict(corrupted, unit.key, unit.corruption, severities)
            for flow, frames, severity in zip(flows, corrupted, severities, strict=True):
                rows.append(self._row(loaded, flow, frames, unit.corruption, severity))
        return rows

    def look(self, key: str, corruption: str, severity: int) -> View:
        """Compute one cell and keep everything of it."""
        loaded = self._load(key)
        frames = self._corrupt(loaded.sample, corruption, severity)
        (flow,) = self._predict([frames], key, corruption, (severity,))
        row = self._row(loaded, flow, frames, corruption, severity)
        return View(loaded.sample, frames, flow, loaded.clean, row)

    def sample(self, key: str) -> Sample:
        """A sample, with its clean frames."""
        return self._load(key).sample

    def clean_flow(self, key: str) -> Flow:
        """The flow of a sample's clean frames, float32 (H, W, 2), pixels."""
        return self._load(key).clean

    def frames(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """The corrupted frames of a cell."""
        return self._corrupt(self._load(key).sample, corruption, severity)

    def _load(self, key: str) -> _Loaded:
        if self._loaded is None or self._loaded.sample.key != key:
            self._loaded = None  # let go of the last sample before the next one is read
            start = time.perf_counter()
            sample = self._dataset.load(key)
            if self._context is not None:
                sample = self._context.add(sample)
            if sample.valid is not None and not sample.valid.any():
                raise DataError(
                    f"sample '{key}': its ground truth marks no pixel as valid, so no error can be measured; "
                    "leave it out with --split, or repair the flow file"
                )
            regions = Regions.of(sample) if sample.flow is not None else None
            self.seconds["load"] += time.perf_counter() - start
            path, made_of = self._clean_path(key), f"{key} {frames_digest(sample.frames)}"
            clean = read_clean(path, made_of)
            if clean is None:
                (clean,) = self._predict([sample.frames], key, CLEAN, (0,))
                write_clean(path, clean, made_of)
            loaded = _Loaded(sample, regions, clean)
            if key in self._kept:
                row = self._row(loaded, clean, sample.frames, CLEAN, 0)
                check_same_data(self._kept[key], row)
                check_same_model(self._kept[key], row)
            self._loaded = loaded
        return self._loaded

    def _corrupt(self, sample: Sample, name: str, severity: int) -> tuple[Frame, ...]:
        start = time.perf_counter()
        paper = self._options.severity_scale == "paper"  # what was corrupted beforehand has the paper's severities
        if paper and isinstance(self._dataset, PreCorrupted) and self._dataset.has_corrupted(name):
            made = self._dataset if self._context is None else self._context
            frames = made.corrupted(sample.key, name, severity)
        else:
            if name not in self._corruptions:
                self._corruptions[name] = load_corruption(name, self._options.variant, self._options.severity_scale)
            corruption = self._corruptions[name]
            seed, common = self._options.seed, self._options.common_draws
            if self._context is not None:
                frames = self._context.corrupt(sample, corruption, severity, seed, common)
            else:
                frames = tuple(corrupt_clip(sample.frames, corruption, severity, seed, sample.key, common_draws=common))
        self.seconds["corrupt"] += time.perf_counter() - start
        return frames

    def _predict(
        self, pairs: list[tuple[Frame, ...]], key: str, corruption: str, severities: tuple[int, ...]
    ) -> list[Flow]:
        """One call of the model for a batch; a single pair goes through `predict`."""
        start = time.perf_counter()
        self._on_predict(place(key, corruption, *severities))
        if self._context is not None:
            flows = [
                self._predict_clip(self._context, frames, key, corruption, severity)
                for frames, severity in zip(pairs, severities, strict=True)
            ]
        elif len(pairs) > 1 and isinstance(self._model, BatchedFlowModel):
            flows = predict_batch_checked(self._model, pairs, key, corruption, severities)
        else:
            assert isinstance(self._model, FlowModel | FlowLookup)
            flows = [
                predict_checked(self._model, frames, key, corruption, severity)
                for frames, severity in zip(pairs, severities, strict=True)
            ]
        self._on_predict(None)
        self.seconds["predict"] += time.perf_counter() - start
        return flows

    def _predict_clip(
        self, context: ContextFrames, frames: tuple[Frame, ...], key: str, corruption: str, severity: int
    ) -> Flow:
        assert isinstance(self._model, ClipModel)
        clip, index = context.in_order(key, frames), place_of_pair(context.offsets(key))
        return predict_clip_checked(self._model, clip, index, key, corruption, severity)

    def _row(
        self, loaded: _Loaded, flow: Flow, frames: tuple[Frame, ...], corruption: str, severity: int
    ) -> dict[str, Any]:
        start = time.perf_counter()
        digest = frames_digest(frames[:2])
        row = measure(
            flow,
            loaded.clean,
            loaded.sample,
            loaded.regions,
            corruption=corruption,
            severity=severity,
            frames_digest=digest,
        )
        if row["n_invalid"] and not self._options.allow_invalid:
            where = place(loaded.sample.key, corruption, severity)
            raise ModelError(
                f"the model returned {row['n_invalid']} pixels that are NaN or infinite on {where}; repair the model, "
                "or give --allow-invalid to leave such pixels out and count them"
            )
        self.seconds["measure"] += time.perf_counter() - start
        if self._options.pictures is not None and corruption != CLEAN:
            keep_picture(self._options.pictures, frames, loaded.sample.frames, corruption, severity, digest)
        return row


def frames_digest(frames: tuple[Frame, ...]) -> str:
    """32 hexadecimal digits that name the exact bytes of some frames."""
    return digest_of_bytes(*(part for frame in frames for part in (str(frame.shape).encode(), _in_order(frame))))


def _in_order(frame: Frame) -> memoryview:
    return np.ascontiguousarray(frame).data.cast("B") if frame.size else memoryview(b"")
