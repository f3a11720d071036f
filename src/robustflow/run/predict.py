"""Predict flow for a user's frames, as flow files, images of the flow, or a video."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..core.errors import DataError, UsageError, unknown_name
from ..core.files import make_folder
from ..core.types import Flow
from ..data.datasets import load_dataset
from ..data.datasets.clips import window_on
from ..data.datasets.dataset import Dataset
from ..data.datasets.pair_files import PairDataset, PairFiles
from ..data.video.clip import write_clip
from ..data.video.codec import I420, crf, rgb_to_i420
from ..media.colours import flow_colours, flow_radius
from ..media.flow import read_flow, write_flow
from ..media.images import image_size, write_image
from ..models import ModelRef
from ..models.protocols import AnyModel
from .config import MeasuringOptions
from .plan import Job, NamedModel, load_predictor
from .worker import temporary_worker

FLOW_FORMATS = ("flo", "png", "pfm", "flo5")
"""File formats for flow; "png" is KITTI's 16-bit format."""


class _Images(PairDataset):
    has_flow = False


@dataclass(frozen=True)
class Predicted:
    key: str
    flow: Path
    radius: float


def frames_of(paths: list[Path], options: Mapping[str, object]) -> Dataset:
    """Open two or more images in the given order, a folder of images, or a video, as pairs of adjacent frames."""
    if len(paths) == 1:
        if paths[0].is_file() and _is_picture(paths[0]):
            raise UsageError(paths[0], "a single frame; give two or more, a folder of frames, or a video")
        return load_dataset("folder", paths[0], **options)
    if options:
        raise UsageError(f"-D {next(iter(options))}", "applies to a folder or a video, not to single images")
    pairs = {
        f"{index:04d}_{first.stem}" if len(paths) > 2 else first.stem: PairFiles((first, second), group="frames")
        for index, (first, second) in enumerate(pairwise(paths))
    }
    return _Images(pairs, paths[0].parent)


def predict_flows(
    model: str | Path | ModelRef | AnyModel,
    dataset: Dataset,
    folder: Path,
    *,
    suffix: str = "flo",
    overwrite: bool = False,
) -> Iterator[Predicted]:
    """Write the flow of every pair as FOLDER/KEY.SUFFIX, and yield each result. Each file is complete or absent."""
    if suffix not in FLOW_FORMATS:
        raise unknown_name("format", suffix, FLOW_FORMATS)
    keys = dataset.keys()
    targets = {key: folder / f"{key}.{suffix}" for key in keys}
    there = [path for path in targets.values() if path.exists()]
    if there and not overwrite:
        raise UsageError(there[0], "already exists; choose a different folder with -o, or use --overwrite")
    for key, flow in flows_of(load_predictor(model), dataset, keys):
        make_folder(targets[key].parent)
        write_flow(targets[key], flow)
        yield Predicted(key, targets[key], flow_radius(flow))


def flows_of(model: NamedModel, dataset: Dataset, keys: Sequence[str]) -> Iterator[tuple[str, Flow]]:
    """Yield key and flow, float32 (H, W, 2) in pixels, of the given pairs of a dataset."""
    measuring, window = MeasuringOptions(allow_invalid=True), window_on(model.model, dataset)
    with temporary_worker(Job(dataset, model, measuring=measuring, window=window)) as worker:
        for key in keys:
            yield key, worker.clean_flow(key)


def write_pictures(predicted: list[Predicted], radius: float) -> Iterator[Path]:
    """Write a colour image of each flow beside its file, KEY.colours.png, all with the same colours."""
    for one in predicted:
        flow, valid = read_flow(one.flow)
        path = one.flow.with_suffix(".colours.png")
        write_image(path, flow_colours(flow, radius, valid))
        yield path


def write_video(path: Path, predicted: list[Predicted], dataset: Dataset, radius: float, fps: float) -> None:
    """Write an MP4 (H.264) that shows the first frame of each pair above its colour-coded flow."""
    height, width = dataset.load(predicted[0].key).shape

    def pictures() -> Iterator[I420]:
        for one in predicted:
            frame = dataset.load(one.key).frames[0]
            if frame.shape[:2] != (height, width):
                raise DataError(one.key, "differs in size from the frames before it; a video has one size")
            flow, valid = read_flow(one.flow)
            yield rgb_to_i420(np.concatenate((frame, flow_colours(flow, radius, valid))))

    make_folder(path.parent)
    write_clip(path, pictures(), (2 * height, width), Fraction(fps).limit_denominator(1001), crf(18))


def _is_picture(path: Path) -> bool:
    try:
        image_size(path)
    except DataError:
        return False
    return True
