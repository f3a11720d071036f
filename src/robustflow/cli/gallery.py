"""`robustflow gallery`: show every corruption of a pair or clip side by side."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from ..core.arguments import SEVERITIES, check_severity
from ..core.display import ProgressBar
from ..core.errors import UsageError
from ..core.files import make_folder, write_bytes
from ..core.output import echo
from .options import DEPTH, depth_of, names, refuse_unused, shared

if TYPE_CHECKING:
    from ..core.types import Sample
    from ..data.datasets.dataset import Dataset


@shared(
    *("severity", "corruptions", "attacks", "seed", "severity_scale", "psf_dir", *DEPTH),
    model="Also draw strip.webp: this model's flow and error under each corruption.",
    still="With --model: pair the first frame with itself, so that errors are phantom motion.",
    output="Folder to write; 'gallery' by default.",
)
def gallery(
    context: typer.Context,
    frames: Annotated[
        tuple[Path, Path] | None, Option("--frames", "-f", help="Two frames; the motorcycle pair by default.")
    ] = None,
    clip: Annotated[Path | None, Option(help="A video or a folder of frames, which the page plays.")] = None,
    start: Annotated[str | None, Option(help="First frame: a frame number (120) or a time (12.5s, 1:05).")] = None,
    stop: Annotated[str | None, Option(help="Frame at which to stop (exclusive).")] = None,
    length: Annotated[int | None, Option(help="Number of frames to show; 10 by default.")] = None,
    **given: Any,
) -> None:
    """Show the corruptions: gallery.png and gallery.pdf at one severity, gallery.html with a slider over all five.

    For a clip, the page plays frames from --start, or from the middle of the clip, and also shows H.264 compression and
    bit errors. With --attacks and a model, attacks.webp shows the attacked frame, the perturbation, and the flow before
    and after.

    \b
    Examples:
      robustflow gallery --model dis --corruptions fog,frost,snow --severity 4
      robustflow gallery --model tiny --attacks pgd,square:queries=200
      robustflow gallery --frames a.png b.png --corruptions fog,snow --severity-scale calibrated -o out
      robustflow gallery --clip clip.mp4 --start 12.5s --corruptions snow,spatter,h264_crf
    """
    from ..data.datasets import load_dataset
    from ..run.predict import frames_of

    model, attacks = given["model"], given["attacks"]
    if clip is None:
        refuse_unused(context, ("start", "stop", "length"), "without --clip")
    else:
        refuse_unused(context, ("frames", *DEPTH, "model"), "with --clip")
    if model is None:
        refuse_unused(context, ("attacks", "still"), "without --model")
    if attacks is not None:
        refuse_unused(context, ("still",), "with --attacks")
    wanted = names(given["corruptions"])
    if attacks is not None and wanted is None:
        refuse_unused(context, {"severity_scale", "psf_dir", *DEPTH}, "with --attacks alone")
    check_severity(given["severity"])
    if wanted is not None:
        from ..corruptions import IMAGE_PAIR, PAPER_ORDER, corruption_name
        from ..corruptions.registry import with_families

        possible = IMAGE_PAIR if clip is None else PAPER_ORDER
        wanted = [corruption_name(name) for name in with_families(wanted, possible)]
    output = given["output"] or Path("gallery")
    if clip is not None:
        _write(output, _clip_files(clip, start, stop, length, wanted, given))
        return
    dataset = load_dataset("motorcycle") if frames is None else frames_of(list(frames), {})
    sample = dataset.load(dataset.keys()[0])
    what = "the motorcycle pair" if frames is None else f"{frames[0].name}, {frames[1].name}"
    if attacks is not None:
        _write(output, _attack_files(sample, names(attacks) or [], given))
    if attacks is None or wanted is not None:
        _write(output, _pair_files(sample, dataset, what, wanted, given))


def _write(output: Path, files: dict[str, bytes]) -> None:

    make_folder(output)
    for name, data in files.items():
        write_bytes(output / name, data)
        echo(str(output / name))


def _pair_files(
    sample: "Sample", dataset: "Dataset", what: str, wanted: list[str] | None, given: dict[str, Any]
) -> dict[str, bytes]:
    from ..corruptions import load_corruption
    from ..data.benchmarks.paper import DEMO_CLASSES
    from ..data.datasets.still import still_scene
    from ..models import load_model
    from ..models.protocols import FlowModel
    from ..report.gallery.cells import pair_cells
    from ..report.gallery.draw import draw_strip
    from ..report.gallery.slider import gallery_files

    severity, seed, scale, model = (given[name] for name in ("severity", "seed", "severity_scale", "model"))
    if given["still"]:
        sample, what = still_scene(sample, 0), f"a frame from {what}"
    classes = DEMO_CLASSES if dataset.name == "motorcycle" else {}
    sample = replace(sample, depth=depth_of(sample, dataset, wanted or (), given))
    cells = list(pair_cells(sample, SEVERITIES, wanted, seed, scale, classes))
    files = gallery_files(f"Corruptions of {what}, {scale} scale", sample.frames[:1], cells, severity)
    if model is None:
        return files
    loaded = load_model(model)
    if not isinstance(loaded, FlowModel):
        raise UsageError(model, "does not predict from two frames, which the strip requires")
    shown = [cell.name for cell in cells if cell.severity == severity and cell.frames and cell.name != "depth"]
    chosen = [load_corruption(name, scale=scale, classes=classes) for name in shown]
    return files | {"strip.webp": draw_strip(sample, loaded.predict, chosen, severity, model, seed)}


def _attack_files(sample: "Sample", attacks: list[str], given: dict[str, Any]) -> dict[str, bytes]:
    from ..attacks import attack, load_attack
    from ..attacks.api import with_controls
    from ..models import load_model
    from ..report.gallery.draw import draw_attacks

    loaded, (first, second) = load_model(given["model"]), sample.frames
    options: dict[str, Any] = {"flow": sample.flow, "valid": sample.valid, "seed": given["seed"], "key": sample.key}
    chosen = [load_attack(name) for name in with_controls(attacks)]
    attacked = [attack(first, second, loaded, method, severity=given["severity"], **options) for method in chosen]
    return {"attacks.webp": draw_attacks(first, attacked, given["model"])}


def _clip_files(
    clip: Path, start: str | None, stop: str | None, length: int | None, wanted: list[str] | None, given: dict[str, Any]
) -> dict[str, bytes]:
    from tempfile import TemporaryDirectory

    from ..report.gallery.cells import SHOWN, ClipPart, chosen_corruptions, clip_cells
    from ..report.gallery.slider import gallery_files

    severity, seed, scale = (given[name] for name in ("severity", "seed", "severity_scale"))
    chosen, remarks = chosen_corruptions(wanted, scale)
    part = ClipPart(clip, start, stop, SHOWN if length is None else length)
    frames, first = list(part.frames(part.shown)), part.first_number
    title = f"Corruptions of {clip.name}, frames {first} to {first + len(frames) - 1}, {scale} scale"
    about = f"{part.count} frames at {float(part.rate):.4g} frames per second; SSIM of the first corrupted frame"
    with TemporaryDirectory(prefix="robustflow-gallery-") as folder, ProgressBar() as progress:
        cells = clip_cells(part, frames, SEVERITIES, chosen, Path(folder), seed, clip.resolve().stem, scale)
        tracked = progress.track(cells, f"{clip.name}: corrupting", len(chosen) * len(SEVERITIES))
        files = gallery_files(title, frames, tracked, severity, first, [about, *remarks])
    for remark in remarks:
        typer.echo(remark, err=True)
    return files
