"""Write figures to files deterministically."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from ...atomic import make_folder, write_bytes
from ...errors import unknown_name
from ...figure_style import default_style

FILE_FORMATS = ("png", "svg", "pdf")


@contextmanager
def any_script() -> Iterator[None]:
    """Suppress matplotlib's warning about missing glyphs where text is only measured, or rendered with the reader's
    fonts."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ ", UserWarning)
        yield


@default_style()
def settle_layout(figure: Figure) -> None:
    """Compute the layout of a figure without drawing it, and keep it: names placed afterwards do not move the panels,
    and the bytes do not depend on how often the figure is drawn."""
    engine = figure.get_layout_engine()
    if engine is not None:
        with any_script():
            engine.execute(figure)
        figure.set_layout_engine(None)  # the layout engine "none" would draw everything twice to measure it


@default_style()
def figure_bytes(figure: Figure, format: str, live_text: bool = False) -> bytes:
    """Encode a figure as "png" (200 dpi), "svg" or "pdf"; equal figures give equal bytes."""
    if format not in FILE_FORMATS:
        raise unknown_name("figure format", format, FILE_FORMATS)
    settle_layout(figure)
    metadata: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[format]
    out = io.BytesIO()
    outlines = "none" if live_text else "path"
    settings: Any = {"svg.hashsalt": "robustflow", "svg.fonttype": outlines, "pdf.fonttype": 42}
    with rc_context(settings), any_script() if live_text else nullcontext():
        figure.savefig(out, format=format, dpi=200, metadata=metadata)
    return out.getvalue()


def write_figures(figures: Mapping[str, Figure], folder: Path, formats: tuple[str, ...] = FILE_FORMATS) -> list[Path]:
    """Write each figure in each format to FOLDER/<name>.<format>."""
    make_folder(folder)
    paths = []
    for name, figure in figures.items():
        for format in formats:
            paths.append(folder / f"{name}.{format}")
            write_bytes(paths[-1], figure_bytes(figure, format))
    return paths
