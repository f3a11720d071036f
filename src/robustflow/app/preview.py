"""Compute one preview: corrupt a pair, predict flow, compute metrics, and draw pictures, with the same numbers as
`corrupt`, the model and the metrics."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..core.errors import UsageError
from ..core.opencv import one_opencv_thread
from ..core.types import Flow, Frame, Frozen, Sample
from ..corruptions import Corruption, corrupt, load_corruption
from ..media.colours import error_colours, flow_colours, flow_radius, thickened
from ..media.images import png_address, shrunk
from ..metrics.error_maps import crer, epe_map
from ..metrics.regions import Regions
from ..metrics.rows import measure
from ..models import FlowModel
from ..models.calls import predict_checked
from ..report.gallery.examples import cell_scores
from .models import Models
from .sources import SourceStore

_WIDEST = 1280
"""Maximum width of a picture, in pixels; metrics are computed at full resolution."""

_CLEAN_KEPT = 4

Stage = Callable[[str], None]


class CorruptionLayer(Frozen):
    """A corruption at a severity."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,60}$")]
    severity: Annotated[int, Field(ge=1, le=5, strict=True)]


class PreviewRequest(Frozen):
    """A page's request."""

    page: Annotated[str, Field(max_length=40)]
    source: Annotated[str, Field(max_length=40)]
    index: Annotated[int, Field(ge=0, strict=True)]
    model: Annotated[str, Field(max_length=300)]
    checkpoint: Annotated[str, Field(max_length=1000)] = ""
    layers: Annotated[list[CorruptionLayer], Field(min_length=1, max_length=4)]
    seed: Annotated[int, Field(ge=0, lt=2**31, strict=True)]
    frames: bool = False

    @property
    def corruption(self) -> tuple[str, int]:
        """Return the name and severity in the form that `corrupt` accepts; several layers form a stack."""
        if len(self.layers) == 1:
            return self.layers[0].name, self.layers[0].severity
        stack = "+".join(f"{layer.name}:{layer.severity}" for layer in self.layers)
        return stack, max(layer.severity for layer in self.layers)


class Previewer:
    """Computes previews, and caches the flow for the most recent clean frames. Used from one thread only."""

    def __init__(self, sources: SourceStore, models: Models) -> None:
        self._sources = sources
        self._models = models
        self._clean: OrderedDict[tuple[str, int, str, str], Flow] = OrderedDict()

    def preview(self, wanted: PreviewRequest, stage: Stage) -> dict[str, Any]:
        """Return pictures as `data:` URLs, and metrics in pixels, None if unavailable."""
        source = self._sources.get(wanted.source)
        if wanted.index >= source.pairs:
            raise UsageError(f"pair {wanted.index + 1}", f"{source.name} has the pairs 1 to {source.pairs}")
        sample = source.sample(wanted.index)
        stage("loading the model")
        model = self._models.load(wanted.model, wanted.checkpoint)
        stage("corrupting")
        name, severity = wanted.corruption
        corruption = load_corruption(name, classes=source.classes)
        measured = sample if corruption.truth == "unchanged" else sample.without_truth()
        corrupted = corrupt(*sample.frames[:2], corruption, severity, wanted.seed, sample.key, depth=sample.depth)
        clean = self._clean_flow(wanted, sample, model, stage)
        stage("predicting the corrupted frames")
        start = time.perf_counter()
        with one_opencv_thread():
            flow = predict_checked(model, corrupted, sample.key, name, severity)
        seconds = time.perf_counter() - start
        stage("drawing")
        return {
            "source": source.name,
            "size": [sample.shape[1], sample.shape[0]],
            "truth": measured.flow is not None,
            "seconds": round(seconds, 3),
            "call": f"corrupt(frame1, frame2, {_described(wanted, source.classes)}, severity={severity}, "
            f"seed={wanted.seed}, key={sample.key!r}{', depth=depth' if corruption.needs_depth else ''})",
            **_numbers(measured, flow, clean, name, severity),
            **_pictures(sample, measured, corrupted, flow, clean, wanted.frames),
        }

    def _clean_flow(self, wanted: PreviewRequest, sample: Sample, model: FlowModel, stage: Stage) -> Flow:
        place = (wanted.source, wanted.index, wanted.model, wanted.checkpoint)
        if place not in self._clean:
            stage("predicting the clean frames")
            with one_opencv_thread():
                self._clean[place] = predict_checked(model, sample.frames, sample.key, "clean", 0)
            while len(self._clean) > _CLEAN_KEPT:
                self._clean.popitem(last=False)
        self._clean.move_to_end(place)
        return self._clean[place]


def _described(wanted: PreviewRequest, classes: Mapping[str, type[Corruption]]) -> str:
    """Return the corruption as a Python expression for users of the library."""
    name, _ = wanted.corruption
    if all(layer.name not in classes for layer in wanted.layers):
        return f'"{name}"'
    return f'load_corruption("{name}", classes=robustflow.data.benchmarks.paper.DEMO_CLASSES)'


def _numbers(sample: Sample, flow: Flow, clean: Flow, name: str, severity: int) -> dict[str, Any]:
    regions = Regions.of(sample) if sample.flow is not None else None
    before = measure(clean, clean, sample, regions)
    row = measure(flow, clean, sample, regions, corruption=name, severity=severity)
    scores, clean_scores = cell_scores(row), cell_scores(before)
    return {
        "numbers": {
            "epe_clean": clean_scores.epe,
            "epe": scores.epe,
            "cre": scores.cre,
            "crer": crer(scores.cre, clean_scores.epe),
            "rcre": scores.rcre,
            "fl": 100 * row["fl_count"] / row["n_valid"] if row["n_valid"] else None,
        },
        "invalid": row["n_invalid"],
    }


def _pictures(
    sample: Sample, measured: Sample, corrupted: tuple[Frame, ...], flow: Flow, clean: Flow, with_frames: bool
) -> dict[str, Any]:
    radius = flow_radius(clean) if sample.flow is None else flow_radius(sample.flow, sample.valid)
    errors = epe_map(flow, clean if measured.flow is None else measured.flow)
    if measured.valid is not None:
        errors[~measured.valid] = np.nan
    pictures = {
        "corrupted1": corrupted[0],
        "corrupted2": corrupted[1],
        "clean_flow": flow_colours(clean, radius),
        "flow": flow_colours(flow, radius),
        "error": thickened(error_colours(errors), ~np.isnan(errors)),
    }
    if with_frames:
        pictures |= {"frame1": sample.frames[0], "frame2": sample.frames[1]}
        if sample.flow is not None and sample.valid is not None:
            pictures["truth_flow"] = thickened(flow_colours(sample.flow, radius, sample.valid), sample.valid)
    # Lossless, because some pictures show noise.
    addresses = {name: png_address(shrunk(picture, _WIDEST)) for name, picture in pictures.items()}
    return {"radius": radius, "pictures": addresses}
