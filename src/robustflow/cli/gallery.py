"""`robustflow gallery`: show every corruption of a pair or clip side by side."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import UsageError
from .options import (
    Attacks,
    Corruptions,
    Depth,
    Focal,
    PsfDir,
    Seed,
    SeverityScale,
    names,
    refuse_unused,
    use_psf_dir,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from ..core.types import Frame, Sample, SceneDepth
    from ..corruptions import Corruption
    from ..report.gallery.pictures import GalleryCell


def gallery(
    context: typer.Context,
    frames: Annotated[
        tuple[Path, Path] | None, typer.Option("--frames", "-f", help="Two frames; the motorcycle pair by default.")
    ] = None,
    clip: Annotated[
        Path | None, typer.Option("--clip", help="A video or a folder of frames, which the page plays.")
    ] = None,
    start: Annotated[
        str | None, typer.Option("--start", help="First frame to show: a frame number (120) or a time (12.5s, 1:05).")
    ] = None,
    stop: Annotated[str | None, typer.Option("--stop", help="Frame at which to stop (exclusive).")] = None,
    length: Annotated[int | None, typer.Option("--length", help="Number of frames to show; 10 by default.")] = None,
    severity: Annotated[int, typer.Option("--severity", "--severities", "-s", help="1 (mild) to 5 (severe).")] = 3,
    corruptions: Corruptions = None,
    attacks: Attacks = None,
    severity_scale: SeverityScale = "paper",
    psf_dir: PsfDir = None,
    depth: Depth = None,
    focal: Focal = None,
    seed: Seed = 0,
    model: Annotated[
        str | None,
        typer.Option("--model", "-m", help="Also draw strip.webp: this model's flow and error under each corruption."),
    ] = None,
    still: Annotated[
        bool,
        typer.Option(
            "--still", help="With --model: pair the first frame with itself, so that errors are phantom motion."
        ),
    ] = False,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("gallery"),
) -> None:
    """Show the corruptions: gallery.png and gallery.pdf at one severity, gallery.html with a slider over all five.

    For a clip, the page plays or steps through frames from --start, or from the middle of the clip. The page then also
    shows H.264 compression and bit errors, which need more than two frames.

    With --attacks and a model, attacks.webp shows the attacked frame, the perturbation, and the flow before and after.

    \b
    Examples:
      robustflow gallery --severity 4
      robustflow gallery --model dis --corruptions fog,frost,snow
      robustflow gallery --model dis --still --corruptions gaussian_noise,fog
      robustflow gallery --model tiny --attacks pgd,square:queries=200
      robustflow gallery --frames a.png b.png --corruptions fog,snow --severity-scale calibrated -o out
      robustflow gallery --clip clip.mp4 --start 12.5s --corruptions snow,spatter,h264_crf
    """
    from ..core.arguments import check_severity

    if frames is not None and clip is not None:
        raise UsageError("--frames and --clip are both given; choose one")
    if clip is not None and (depth is not None or focal is not None):
        raise UsageError("--depth and --focal apply to the depth of two frames; omit --clip, or leave them out")
    if clip is None and not (start is None and stop is None and length is None):
        raise UsageError("--start, --stop and --length require --clip")
    if clip is not None and model is not None:
        raise UsageError("--model draws the flow of two frames; omit --clip, or use `robustflow predict`")
    if attacks is not None and model is None:
        raise UsageError("--attacks needs a model: give it with --model")
    if still and (model is None or attacks is not None):
        raise UsageError("--still shows a model's phantom motion under corruptions: give --model, and omit --attacks")
    if attacks is not None and corruptions is None:
        refuse_unused(context, {"severity_scale", "psf_dir", "depth", "focal"}, "with --attacks alone")
    check_severity(severity)
    use_psf_dir(psf_dir)
    wanted = names(corruptions)
    if wanted is not None:
        from ..corruptions import IMAGE_PAIR, PAPER_ORDER, corruption_name
        from ..corruptions.registry import with_families

        possible = IMAGE_PAIR if clip is None else PAPER_ORDER
        wanted = [corruption_name(name) for name in with_families(wanted, possible)]
    shown = _GalleryRequest(wanted, severity, severity_scale, seed, output)
    if attacks is not None and model is not None:
        _attacked(shown, _sample_of(frames)[0], names(attacks) or [], model)
        if wanted is None:
            return
    if clip is None:
        _write_pair_gallery(shown, frames, model, depth, focal, still)
    else:
        _write_clip_gallery(shown, clip, start, stop, length)


@dataclass(frozen=True)
class _GalleryRequest:
    """What a gallery shows, and where it is written; `corruptions` is None for all of them."""

    corruptions: list[str] | None
    severity: int
    scale: str
    seed: int
    output: Path


def _write_pair_gallery(
    shown: _GalleryRequest,
    frames: tuple[Path, Path] | None,
    model: str | None,
    depth: Path | None,
    focal: float | None,
    still: bool,
) -> None:
    from ..core.arguments import SEVERITIES
    from ..data.benchmarks.demo import DEMO_CLASSES
    from ..data.datasets.still import still_scene
    from ..report.gallery.page import gallery_slider, page_of
    from ..report.gallery.pictures import gallery as cells_of

    sample, what = _sample_of(frames)
    if still:
        sample, what = still_scene(sample, 0), f"a frame from {what}"
    classes = DEMO_CLASSES if frames is None else {}
    sample = replace(sample, depth=_depth_of(frames, sample, shown.corruptions or [], depth, focal))
    cells = list(cells_of(sample, SEVERITIES, shown.corruptions, shown.seed, shown.scale, classes))
    title = f"Corruptions of {what}, {shown.scale} scale"
    at = [cell for cell in cells if cell.severity == shown.severity]
    slider = gallery_slider(title, sample.frames[:1], cells, SEVERITIES, shown.severity)
    _write(shown, sample.frames[0], at, title, page_of(slider))
    if model is not None:
        _write_strip(shown, sample, model, [cell.name for cell in at if cell.ssim is not None], classes)


def _sample_of(frames: tuple[Path, Path] | None) -> "tuple[Sample, str]":
    """Return the pair and its name."""
    from ..core.types import Sample
    from ..data.datasets import load_dataset
    from ..media.images import read_image

    if frames is None:
        return load_dataset("motorcycle", None).load("motorcycle"), "the motorcycle pair"
    pair = read_image(frames[0]), read_image(frames[1])
    return Sample(frames[0].stem, pair), f"{frames[0].name}, {frames[1].name}"


def _depth_of(
    frames: tuple[Path, Path] | None, sample: "Sample", corruptions: list[str], depth: Path | None, focal: float | None
) -> "SceneDepth | None":
    """Return the depth of the pair if a corruption needs it."""
    from ..data.benchmarks import Benchmark
    from ..data.benchmarks.registry import with_own_depth
    from ..data.datasets import load_dataset
    from ..run.predict import frames_of

    dataset = load_dataset("motorcycle") if frames is None else frames_of(list(frames), {})
    pair = Benchmark("gallery", dataset, (sample.key,), tuple(corruptions))
    depths = with_own_depth(pair, depth, focal).depth_to_read()
    return None if depths is None else depths.depth(sample)


def _attacked(shown: _GalleryRequest, sample: "Sample", attacks: list[str], model: str) -> None:
    from functools import partial

    from ..attacks import attack, load_attack
    from ..attacks.api import with_controls
    from ..core.files import make_folder, write_bytes
    from ..models import load_model
    from ..report.gallery.strip import draw_attacks

    chosen = [load_attack(name) for name in with_controls(attacks)]
    loaded = load_model(model)
    first, second = sample.frames
    attacked = partial(
        attack,
        *(first, second, loaded),
        severity=shown.severity,
        flow=sample.flow,
        valid=sample.valid,
        seed=shown.seed,
        key=sample.key,
    )
    galleries = [attacked(each) for each in chosen]
    make_folder(shown.output)
    write_bytes(shown.output / "attacks.webp", draw_attacks(first, galleries, model))
    typer.echo(str(shown.output / "attacks.webp"))


def _write_strip(
    shown: _GalleryRequest,
    sample: "Sample",
    model: str,
    corruptions: list[str],
    classes: "Mapping[str, type[Corruption]]",
) -> None:
    from ..core.files import write_bytes
    from ..corruptions import load_corruption
    from ..models import load_model
    from ..models.base import FlowModel
    from ..report.gallery.strip import draw_strip, strip_columns

    loaded = load_model(model)
    if not isinstance(loaded, FlowModel):
        raise UsageError(f"model '{model}' does not predict from two frames, which the strip requires")
    chosen = [load_corruption(name, scale=shown.scale, classes=classes) for name in corruptions]
    columns = strip_columns(sample, loaded.predict, chosen, shown.severity, shown.seed)
    write_bytes(shown.output / "strip.webp", draw_strip(sample, columns, model))
    typer.echo(str(shown.output / "strip.webp"))


def _write_clip_gallery(
    shown: _GalleryRequest, clip: Path, start: str | None, stop: str | None, length: int | None
) -> None:
    from tempfile import TemporaryDirectory

    from ..core.arguments import SEVERITIES
    from ..core.display import ProgressBar
    from ..report.gallery.page import gallery_slider, page_of
    from ..report.gallery.pictures import SHOWN, ClipPart, chosen_corruptions, clip_cells

    chosen, remarks = chosen_corruptions(shown.corruptions, shown.scale)
    part = ClipPart(clip, start, stop, SHOWN if length is None else length)
    frames = list(part.frames(part.shown))
    key = clip.resolve().stem
    first, last = part.first_number, part.first_number + len(frames) - 1
    title = f"Corruptions of {clip.name}, frames {first} to {last}, {shown.scale} scale"
    at: list[GalleryCell] = []

    def collect(cells: "Iterable[GalleryCell]") -> "Iterator[GalleryCell]":
        for cell in cells:
            if cell.severity == shown.severity:
                at.append(cell)
            yield cell

    with TemporaryDirectory(prefix="robustflow-gallery-") as folder, ProgressBar() as progress:
        cells = clip_cells(part, frames, SEVERITIES, chosen, Path(folder), shown.seed, key, shown.scale)
        tracked = progress.track(cells, f"{clip.name}: corrupting", len(chosen) * len(SEVERITIES))
        slider = gallery_slider(title, frames, collect(tracked), SEVERITIES, shown.severity, first)
    position = "middle" if start is None else "first"
    remarks = [
        f"The frames are the {position} of {part.count} frames at {float(part.rate):.4g} frames per second, "
        "corrupted at full size; the SSIM is that of the first frame that the corruption changes.",
        *remarks,
    ]
    _write(shown, frames[0], at, title, page_of(slider, remarks))
    for remark in remarks[1:]:
        typer.echo(remark, err=True)


def _write(shown: _GalleryRequest, clean: "Frame", at: "Sequence[GalleryCell]", title: str, page: str) -> None:
    from ..core.files import make_folder, write_bytes
    from ..report.gallery.page import draw_figure

    make_folder(shown.output)
    title = f"{title}, severity {shown.severity}"
    files = {f"gallery.{form}": draw_figure(clean, at, title, form) for form in ("png", "pdf")}
    for name, data in (files | {"gallery.html": page.encode()}).items():
        write_bytes(shown.output / name, data)
        typer.echo(str(shown.output / name))
