"""Example pictures of a page: those in a run's folder, or else the embedded pair, drawn once and cached per user.

A run's folder is untrusted: its list is validated, file names must be plain names, and pictures are decoded and
encoded again so that only pixels reach the page.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ...core.arguments import SEVERITIES
from ...core.errors import AssetError, DataError, first_misfit
from ...core.files import (
    cache_folder,
    digest_of_bytes,
    digest_of_value,
    make_folder,
    read_bounded,
    sealed,
    unsealed,
    write_json,
)
from ...core.text import plain
from ...core.types import Frame
from ...data.benchmarks.facts import is_still
from ...data.benchmarks.paper import DEMO_CLASSES
from ...data.datasets import load_dataset
from ...media.images import jpeg_address, read_image
from ...run.stages import SLIDER_WIDTH
from ...run.trust import code_digest
from ...stats.lines import LineKey
from ...stats.results import long_label
from ..gallery.cells import GalleryCell, pair_cells
from ..gallery.examples import EXAMPLES_FILE, FOLDER, ExampleList, Panel, example_list
from ..gallery.layout import picture_of_panel
from ..gallery.slider import Slider, make_slider

if TYPE_CHECKING:
    from ...run.run import Run

_KEY = "motorcycle"
_TITLE = "Middlebury 2014, Motorcycle"
_LARGEST = 1 << 24
"""Maximum size of a picture and of the cached slider in bytes."""
_LARGEST_LIST = 1 << 20
_TILE_WIDTH = 560
_QUALITY = 62

Tile = tuple[str, str]
"""The caption and the address of a picture."""
_PAIRS = ("frame 1", "frame 2", "corrupted frame 1", "corrupted frame 2")
_SHOWN = (*_PAIRS, "flow, clean frames", "flow, corrupted frames")
_WITH_TRUTH = (*_SHOWN, "ground truth (black: unknown)", "error, corrupted frames")
_WITHOUT_TRUTH = (*_SHOWN, "", "change of the flow")
_STILL = (*_PAIRS[2:], "phantom motion, clean frames", "phantom motion, corrupted frames", "the frame", "its length")

MOST_RUNS = 12
"""Maximum number of runs whose panels a page shows, because each run adds a third of a megabyte. With more runs, only
the panels of the first one are shown."""


def embedded_slider() -> Slider | None:
    """Return a slider that shows the embedded pair under every image-pair corruption, with the frost variant that needs
    no download. Return None, with a warning, if scikit-image does not include the pair. Cached pictures from a
    different version of this package, or of different frames, are redrawn."""
    try:
        sample = load_dataset(_KEY, None).load(_KEY)
    except AssetError as error:
        warnings.warn(f"no example pictures: {error}", stacklevel=3)
        return None
    frames = (digest_of_bytes(frame.tobytes()) for frame in sample.frames)
    source = digest_of_value([code_digest(), *frames], size=16)
    path = cache_folder("gallery") / f"{_KEY}.json"
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):  # absent or damaged: drawn again
        if path.stat().st_size <= _LARGEST:
            document = json.loads(unsealed(path.read_bytes()) or "{}")
            if document["source"] == source:
                return TypeAdapter(Slider).validate_python(document["slider"])
    cells = pair_cells(sample, SEVERITIES, classes=DEMO_CLASSES)
    slider = make_slider(_TITLE, sample.frames[:1], cells, widest=256, quality=50)
    with suppress(DataError):  # the cache is not writable, so the slider is redrawn next time
        make_folder(path.parent)
        write_json(path, sealed({"source": source, "slider": asdict(slider)}))
    return slider


@dataclass(frozen=True)
class PanelPicture:
    """The pictures of a sample with its predicted flow and the errors, of which a page's first screen has those in
    `shown`; `corruption` is the name used in tables."""

    title: str
    corruption: str
    severity: int
    numbers: str
    tiles: list[Tile]
    shown: list[int]


@dataclass(frozen=True)
class Examples:
    """Pictures for a page: a slider, and the panels of each run."""

    slider: Slider
    panels: Mapping[LineKey, list[PanelPicture]] = field(default_factory=dict)


def examples_of(runs: Mapping[LineKey, Run]) -> Examples | None:
    """Return the slider of the first run with examples, and the panels of the first `MOST_RUNS` runs."""
    slider: Slider | None = None
    panels: dict[LineKey, list[PanelPicture]] = {}
    most = MOST_RUNS if len(runs) <= MOST_RUNS else 1
    for line, run in runs.items():
        pictures = run_examples(run) if len(panels) < most else None
        if pictures is not None:
            slider = slider or pictures[0]
            panels[line] = pictures[1]
    return None if slider is None else Examples(slider, panels)


def run_examples(run: Run) -> tuple[Slider, list[PanelPicture]] | None:
    """Read the pictures from a run's folder; None if it has none, or only those of rows before the run went on."""
    folder, path = run.path / FOLDER, run.path / FOLDER / EXAMPLES_FILE
    if not path.is_file():
        return None
    data = read_bounded(path, _LARGEST_LIST, "delete the folder, or run the command again")
    try:
        shown = ExampleList.model_validate_json(data)
    except ValidationError as error:
        raise DataError(path, f"{first_misfit(error)}; delete the folder, or run the command again") from error
    if shown != example_list(run.rows):
        return None
    cells = (GalleryCell(one.corruption, one.severity, [_picture(folder / one.file)]) for one in shown.slider.pictures)
    clean = [_picture(folder / shown.slider.clean)]
    slider = make_slider(f"Sample {plain(shown.slider.key)}", clean, cells, widest=SLIDER_WIDTH, quality=_QUALITY)
    still, truth = is_still(run.benchmark), run.epe_clean is not None
    return slider, [_panel(folder / panel.file, panel, still, truth) for panel in shown.panels]


def _panel(path: Path, panel: Panel, still: bool, truth: bool) -> PanelPicture:
    corruption = plain(long_label(panel.corruption))
    values = (("EPE", panel.epe), ("CRE", panel.cre), ("RCRE", panel.rcre))
    numbers = ", ".join(f"{label} {value:.2f} px" for label, value in values if value is not None)
    title = f"{panel.kind.capitalize()} sample: {plain(panel.key)}, {corruption}, severity {panel.severity}"
    return PanelPicture(title, corruption, panel.severity, numbers, *_tiles(_picture(path), still, truth))


def _tiles(panel: Frame, still: bool, truth: bool) -> tuple[list[Tile], list[int]]:
    """Cut the image of a panel into its pictures; return them with their captions, and the places of the corrupted
    frame, the clean flow, the flow and its error. Both are empty if the image does not have the size of a panel."""
    captions = _STILL if still else _WITH_TRUTH if truth else _WITHOUT_TRUTH
    cut = [picture_of_panel(panel, place, len(captions) // 2) for place in range(len(captions))]
    parts = [part for part in cut if part is not None and part.size]
    if len(parts) < len(cut):
        return [], []
    change = [float(np.abs(parts[place].astype(int) - parts[place + 2]).mean()) for place in (0, 1)]
    first = 2 + (change[1] > change[0])  # over_exposure changes one of the two frames
    tiles = [
        (caption, jpeg_address(part, _TILE_WIDTH, _QUALITY))
        for caption, part in zip(captions, parts, strict=True)
        if caption
    ]
    return tiles, [0, 2, 3, 5] if still else [first, 4, 5, len(tiles) - 1]


def _picture(path: Path) -> Frame:
    if path.is_symlink():
        raise DataError(path, "a symbolic link; example pictures must be regular files")
    if path.is_file() and path.stat().st_size > _LARGEST:
        raise DataError(path, f"larger than {_LARGEST >> 20} MiB; example pictures are much smaller")
    return read_image(path)
