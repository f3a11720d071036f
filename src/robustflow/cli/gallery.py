"""`robustflow gallery`: every corruption of one pair side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Corruptions, PsfDir, Seed, SeverityScale, names, use_psf_dir


def gallery(
    frames: Annotated[
        tuple[Path, Path] | None, typer.Option("--frames", "-f", help="Two frames; the motorcycle pair by default.")
    ] = None,
    severity: Annotated[int, typer.Option("--severity", "--severities", "-s", help="1 (mild) to 5 (severe).")] = 3,
    corruptions: Corruptions = None,
    severity_scale: SeverityScale = "paper",
    psf_dir: PsfDir = None,
    seed: Seed = 0,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("gallery"),
) -> None:
    """Show the corruptions: gallery.png and gallery.pdf at one severity, gallery.html with a slider over all five.

    The four corruptions of whole clips (h264_crf, ...) are not among them: two frames are not enough.

    \b
    Examples:
      robustflow gallery --severity 4
      robustflow gallery --frames a.png b.png --corruptions fog,snow --severity-scale calibrated -o out
    """
    from ..atomic import make_folder, write_bytes
    from ..datasets import load_dataset
    from ..images.io import read_image
    from ..report.gallery.figure import draw_figure
    from ..report.gallery.page import render_page
    from ..report.gallery.pictures import gallery as cells_of
    from ..severity import SEVERITIES, check_severity

    use_psf_dir(psf_dir)
    check_severity(severity)
    if frames is None:
        key, what = "motorcycle", "the motorcycle pair"
        pair = load_dataset("motorcycle", None).load(key).frames
    else:
        key, what = frames[0].stem, f"{frames[0].name}, {frames[1].name}"
        pair = (read_image(frames[0]), read_image(frames[1]))
    cells = list(cells_of(pair[0], pair[1], SEVERITIES, names(corruptions), seed, key, severity_scale))
    at = [cell for cell in cells if cell.severity == severity]
    title = f"Corruptions of {what}, {severity_scale} scale"
    make_folder(output)
    for form in ("png", "pdf"):
        write_bytes(output / f"gallery.{form}", draw_figure(pair[0], at, f"{title}, severity {severity}", form))
    write_bytes(output / "gallery.html", render_page(pair[0], cells, severity, title).encode())
    for form in ("png", "pdf", "html"):
        typer.echo(str(output / f"gallery.{form}"))
