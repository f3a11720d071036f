"""`robustflow gallery`: show every corruption of a pair or clip side by side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UsageError
from .options import Attacks, Corruptions, Depth, Focal, PsfDir, Seed, SeverityScale, attack_names, names, use_psf_dir

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from ..corruptions import Corruption
    from ..report.gallery.clip import ClipCell
    from ..report.gallery.pictures import CorruptedPicture
    from ..sample import Frame, Sample, SceneDepth


def gallery(
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
    from ..severity import check_severity

    if frames is not None and clip is not None:
        raise UsageError("--frames and --clip are both given; choose one")
    if clip is None and not (start is None and stop is None and length is None):
        raise UsageError("--start, --stop and --length require --clip")
    if clip is not None and model is not None:
        raise UsageError("--model draws the flow of two frames; omit --clip, or use `robustflow predict`")
    if attacks is not None and model is None:
        raise UsageError("--attacks needs a model: give it with --model")
    if still and (model is None or attacks is not None):
        raise UsageError("--still shows a model's phantom motion under corruptions: give --model, and omit --attacks")
    check_severity(severity)
    use_psf_dir(psf_dir)
    wanted = names(corruptions)
    if wanted is not None:
        from ..corruptions import corruption_name

        wanted = [corruption_name(name) for name in wanted]
    if attacks is not None and model is not None:
        _attacked(frames, severity, attack_names(attacks) or [], seed, output, model)
        if wanted is None:
            return
    if clip is None:
        _of_pair(frames, severity, wanted, severity_scale, seed, output, model, depth, focal, still)
    else:
        _of_clip(clip, start, stop, length, severity, wanted, severity_scale, seed, output)


def _of_pair(
    frames: tuple[Path, Path] | None,
    severity: int,
    wanted: list[str] | None,
    scale: str,
    seed: int,
    output: Path,
    model: str | None,
    depth: Path | None,
    focal: float | None,
    still: bool,
) -> None:
    from ..benchmarks.demo import DEMO_CLASSES
    from ..datasets.still import still_scene
    from ..report.gallery.page import render_page
    from ..report.gallery.pictures import gallery as cells_of
    from ..severity import SEVERITIES

    sample, what = _sample_of(frames)
    if still:
        sample, what = still_scene(sample, 0), f"a frame from {what}"
    key, pair = sample.key, sample.frames
    classes = DEMO_CLASSES if frames is None else {}
    scene = _depth_of(frames, sample, wanted or [], depth, focal)
    cells = list(cells_of(pair[0], pair[1], SEVERITIES, wanted, seed, key, scale, classes, scene))
    title = f"Corruptions of {what}, {scale} scale"
    at = [cell for cell in cells if cell.severity == severity]
    page = render_page(pair[0], cells, severity, title)
    _write(output, pair[0], at, f"{title}, severity {severity}", page)
    if model is not None:
        _write_strip(
            output, sample, model, [c.name for c in at if c.frame is not None and not c.caption], severity, seed, scale,
            classes, scene,
        )  # fmt: skip


def _sample_of(frames: tuple[Path, Path] | None) -> "tuple[Sample, str]":
    """Return the pair and its name."""
    from ..datasets import load_dataset
    from ..images.io import read_image
    from ..sample import Sample

    if frames is None:
        return load_dataset("motorcycle", None).load("motorcycle"), "the motorcycle pair"
    pair = read_image(frames[0]), read_image(frames[1])
    return Sample(frames[0].stem, pair), f"{frames[0].name}, {frames[1].name}"


def _depth_of(
    frames: tuple[Path, Path] | None, sample: "Sample", corruptions: list[str], depth: Path | None, focal: float | None
) -> "SceneDepth | None":
    """Return the depth of the pair if a corruption needs it."""
    from ..benchmarks import Benchmark
    from ..datasets import load_dataset
    from ..datasets.own_depth import OwnDepth
    from ..runner.predict import frames_of

    dataset = load_dataset("motorcycle") if frames is None else frames_of(list(frames), {})
    own = None if depth is None else OwnDepth(depth, dataset, focal)
    depths = Benchmark("gallery", dataset, (sample.key,), tuple(corruptions), own_depth=own).depth_to_read()
    return None if depths is None else depths.depth(sample)


def _attacked(
    frames: tuple[Path, Path] | None, severity: int, attacks: list[str], seed: int, output: Path, model: str
) -> None:
    from ..atomic import make_folder, write_bytes
    from ..attacks import attack, load_attack
    from ..attacks.api import with_controls
    from ..models import load_model
    from ..report.gallery.strip import draw_attacks

    chosen = [load_attack(name) for name in with_controls(attacks)]
    sample, _ = _sample_of(frames)
    loaded = load_model(model)
    first, second = sample.frames[:2]
    made = [
        attack(first, second, loaded, each, severity, flow=sample.flow, valid=sample.valid, seed=seed, key=sample.key)
        for each in chosen
    ]
    make_folder(output)
    write_bytes(output / "attacks.webp", draw_attacks(first, made, model))
    typer.echo(str(output / "attacks.webp"))


def _write_strip(
    output: Path,
    sample: "Sample",
    model: str,
    corruptions: list[str],
    severity: int,
    seed: int,
    scale: str,
    classes: "Mapping[str, type[Corruption]]",
    depth: "SceneDepth | None",
) -> None:
    from ..atomic import write_bytes
    from ..corruptions import load_corruption
    from ..models import load_model
    from ..models.base import FlowModel
    from ..report.gallery.strip import draw_strip, strip_columns

    loaded = load_model(model)
    if not isinstance(loaded, FlowModel):
        raise UsageError(f"model '{model}' does not predict from two frames, which the strip requires")
    chosen = [load_corruption(name, scale=scale, classes=classes) for name in corruptions]
    columns = strip_columns(sample.frames[:2], loaded.predict, chosen, severity, seed, sample.key, depth)
    write_bytes(output / "strip.webp", draw_strip(sample, columns, model))
    typer.echo(str(output / "strip.webp"))


def _of_clip(
    clip: Path,
    start: str | None,
    stop: str | None,
    length: int | None,
    severity: int,
    wanted: list[str] | None,
    scale: str,
    seed: int,
    output: Path,
) -> None:
    from tempfile import TemporaryDirectory

    from rich.console import Console
    from rich.progress import track

    from ..report.gallery.clip import SHOWN, ClipPart, chosen_corruptions, clip_cells
    from ..report.gallery.page import clip_slider, page_of
    from ..report.gallery.pictures import CorruptedPicture
    from ..severity import SEVERITIES

    chosen, remarks = chosen_corruptions(wanted, scale)
    part = ClipPart(clip, start, stop, SHOWN if length is None else length)
    shown = list(part.frames(part.shown))
    key = clip.resolve().stem
    first, last = part.first_number, part.first_number + len(shown) - 1
    title = f"Corruptions of {clip.name}, frames {first} to {last}, {scale} scale"
    at: list[CorruptedPicture] = []

    def kept(folder: str) -> "Iterator[ClipCell]":
        cells = clip_cells(part, shown, SEVERITIES, chosen, Path(folder), seed, key, scale)
        total = len(chosen) * len(SEVERITIES)
        console = Console(stderr=True)
        for cell in track(cells, "corrupting", total, console=console, disable=not console.is_terminal, transient=True):
            if cell.severity == severity:
                at.append(CorruptedPicture(cell.name, severity, cell.frames[0] if cell.frames else None, 0, cell.ssim))
            yield cell

    with TemporaryDirectory(prefix="robustflow-gallery-") as folder:
        slider = clip_slider(shown, kept(folder), SEVERITIES, severity, title, first)
    which = "middle" if start is None else "first"
    remarks = [
        f"The frames are the {which} of {part.count} frames at {float(part.rate):.4g} frames per second, "
        "corrupted at full size; the SSIM is that of the first frame.",
        *remarks,
    ]
    _write(output, shown[0], at, f"{title}, severity {severity}", page_of(slider, remarks))
    for remark in remarks[1:]:
        typer.echo(remark, err=True)


def _write(output: Path, clean: "Frame", at: "Sequence[CorruptedPicture]", title: str, page: str) -> None:
    from ..atomic import make_folder, write_bytes
    from ..report.gallery.figure import draw_figure

    make_folder(output)
    for form in ("png", "pdf"):
        write_bytes(output / f"gallery.{form}", draw_figure(clean, at, title, form))
    write_bytes(output / "gallery.html", page.encode())
    for form in ("png", "pdf", "html"):
        typer.echo(str(output / f"gallery.{form}"))
