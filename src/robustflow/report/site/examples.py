"""Example pictures from a run's folder, or of the embedded pair, for inclusion in a page.

The folder is untrusted: its list is validated, file names must be plain names, and pictures are decoded and re-encoded
so that only pixels reach the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, ValidationError

from ...analysis.labels import long_label
from ...analysis.model_result import ModelResult
from ...bounded_file import read_bounded
from ...errors import DataError, first_misfit
from ...images.io import jpeg_address, read_image, shrunk
from ...runs.example_list import EXAMPLES_FILE, FOLDER, SLIDER_WIDTH
from ...sample import Frame
from ...text import plain
from ...validated import Untrusted
from ..slider import Slider, make_slider

if TYPE_CHECKING:
    from ...runs.run import Run

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
            f"{folder / EXAMPLES_FILE}: {first_misfit(error)}; delete the folder, or run the command again"
        ) from error
    clean = _read(folder / shown.slider.clean)
    pictures = ((one.corruption, one.severity, [_read(folder / one.file)], "") for one in shown.slider.pictures)
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
    frame = shrunk(_read(folder / panel.file), _PANEL_WIDTH)
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


def _read(path: Path) -> Frame:
    if path.is_symlink():
        raise DataError(f"{path} is a symbolic link; example pictures must be regular files")
    if path.is_file() and path.stat().st_size > _LARGEST_PICTURE:
        raise DataError(f"{path} is larger than {_LARGEST_PICTURE >> 20} MiB; example pictures are much smaller")
    return read_image(path)
