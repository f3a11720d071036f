"""Slider that shows the embedded pair, for pages whose runs have no pictures; drawn once and cached per user.
Example pictures from a run's folder, or of the embedded pair, for inclusion in a page.

The folder is untrusted: its list is validated, file names must be plain names, and pictures are decoded and re-encoded
so that only pixels reach the page.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

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
from ...core.types import Frame, Untrusted
from ...data.benchmarks.demo import DEMO_CLASSES
from ...data.datasets import load_dataset
from ...media.images import jpeg_address, read_image, shrunk
from ...run.example_cells import EXAMPLES_FILE, FOLDER, SLIDER_WIDTH
from ...run.staleness import code_digest
from ...stats.model_result import ModelResult
from ...stats.results import long_label
from ..gallery.page import example_slider
from ..gallery.pictures import gallery
from ..slider import Slider, make_slider

if TYPE_CHECKING:
    from ...run.run import Run

_KEY = "motorcycle"
_TITLE = "Middlebury 2014, Motorcycle"
_PICTURE = "data:image/jpeg;base64,"
_LARGEST = 2**24


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
    slider = _read(source)
    if slider is None:
        slider = example_slider(sample.frames[0], gallery(sample, SEVERITIES, classes=DEMO_CLASSES), _TITLE)
        _write(slider, source)
    return slider


def _read(source: str) -> Slider | None:
    path = cache_folder("gallery") / f"{_KEY}.json"
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            return None
        content = unsealed(path.read_bytes())
        document = {} if content is None else json.loads(content)
        if document.get("source") != source:
            return None
        slider = TypeAdapter(Slider).validate_python(document["slider"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError, ValidationError):
        return None
    shots = (shot for _, shots in slider.corruptions for shot in shots)
    pictures = [*slider.clean, *(picture for shot in shots for picture in shot.pictures)]
    return slider if all(picture.startswith(_PICTURE) for picture in pictures) else None


def _write(slider: Slider, source: str) -> None:
    folder = cache_folder("gallery")
    try:
        make_folder(folder)
        write_json(folder / f"{_KEY}.json", sealed({"source": source, "slider": asdict(slider)}))
    except DataError:
        pass  # the cache is not writable, so the slider is redrawn next time


_LARGEST_LIST = 1 << 20
_LARGEST_PICTURE = 1 << 24
_PANEL_WIDTH = 1200
_QUALITY = 62

MOST_RUNS = 12
"""Maximum number of runs whose panels a page shows, because each run adds a third of a megabyte. With more runs, only
the panels of the first ones are shown."""

_File = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
_Text = Annotated[str, Field(max_length=500)]
_Severity = Annotated[int, Field(ge=1, le=5)]


class _PictureEntry(Untrusted):
    corruption: _Text
    severity: _Severity
    file: _File


class _SliderEntry(Untrusted):
    key: _Text
    clean: _File
    pictures: Annotated[list[_PictureEntry], Field(max_length=300)]


class _PanelEntry(_PictureEntry):
    kind: Literal["worst", "median"]
    key: _Text
    epe: float | None
    cre: float | None
    rcre: float | None


class _ExampleList(Untrusted):
    version: Literal[1]
    slider: _SliderEntry
    panels: Annotated[list[_PanelEntry], Field(max_length=8)]


@dataclass(frozen=True)
class Examples:
    """Pictures for a page: a slider, and the panels of each run."""

    slider: Slider
    panels: Mapping[ModelResult, list[PanelPicture]] = field(default_factory=dict)


@dataclass(frozen=True)
class PanelPicture:
    """A picture of a sample with its predicted flow and the errors; `corruption` is the name used in tables."""

    title: str
    corruption: str
    severity: int
    numbers: str
    picture: str
    width: int
    height: int


def run_examples(run: Run) -> tuple[Slider, list[PanelPicture]] | None:
    """Read the pictures from a run's folder; None if it has none."""
    folder = run.path / FOLDER
    if not (folder / EXAMPLES_FILE).is_file():
        return None
    data = read_bounded(folder / EXAMPLES_FILE, _LARGEST_LIST, "delete the folder, or run the command again")
    try:
        shown = _ExampleList.model_validate_json(data)
    except ValidationError as error:
        raise DataError(
            folder / EXAMPLES_FILE, f"{first_misfit(error)}; delete the folder, or run the command again"
        ) from error
    clean = _read_of_examples(folder / shown.slider.clean)
    pictures = (
        (one.corruption, one.severity, [_read_of_examples(folder / one.file)], "") for one in shown.slider.pictures
    )
    slider = make_slider(f"Sample {plain(shown.slider.key)}", [clean], pictures, widest=SLIDER_WIDTH, quality=_QUALITY)
    return slider, [_panel(folder, panel) for panel in shown.panels]


def examples_of(lines: Sequence[ModelResult]) -> Examples | None:
    """Return the slider of the first run with examples, and the panels of the first `MOST_RUNS` runs."""
    slider: Slider | None = None
    panels: dict[ModelResult, list[PanelPicture]] = {}
    most = MOST_RUNS if len(lines) <= MOST_RUNS else 1
    for line in lines:
        pictures = run_examples(line.run) if line.run and len(panels) < most else None
        if pictures is not None:
            slider = slider or pictures[0]
            panels[line] = pictures[1]
    return None if slider is None else Examples(slider, panels)


def _panel(folder: Path, panel: _PanelEntry) -> PanelPicture:
    frame = shrunk(_read_of_examples(folder / panel.file), _PANEL_WIDTH)
    height, width = frame.shape[:2]
    kind = {"worst": "Worst sample", "median": "Median sample"}[panel.kind]
    title = f"{kind}: {plain(panel.key)}, {plain(long_label(panel.corruption))}, severity {panel.severity}"
    values = (("EPE", panel.epe), ("CRE", panel.cre), ("RCRE", panel.rcre))
    numbers = ", ".join(f"{label} {value:.2f} px" for label, value in values if value is not None)
    return PanelPicture(
        title,
        plain(long_label(panel.corruption)),
        panel.severity,
        numbers,
        jpeg_address(frame, _PANEL_WIDTH, _QUALITY),
        width,
        height,
    )


def _read_of_examples(path: Path) -> Frame:
    if path.is_symlink():
        raise DataError(f"{path} is a symbolic link; example pictures must be regular files")
    if path.is_file() and path.stat().st_size > _LARGEST_PICTURE:
        raise DataError(f"{path} is larger than {_LARGEST_PICTURE >> 20} MiB; example pictures are much smaller")
    return read_image(path)
