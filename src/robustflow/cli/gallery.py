"""`robustflow gallery`: show every corruption of a pair or clip side by side."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from ..core.errors import UsageError
from .options import names, refuse_unused, shared

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from ..core.types import Frame, Sample, SceneDepth
    from ..corruptions import Corruption
    from ..report.gallery.pictures import GalleryCell


@shared(
    *("severity", "corruptions", "attacks", "seed", "severity_scale", "psf_dir", "depth", "focal"),
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
    from ..core.arguments import check_severity

    model, attacks = given["model"], given["attacks"]
    if clip is not None:
        for flag, value in {
            "--frames": frames,
            "--depth": given["depth"],
            "--focal": given["focal"],
            "--model": model,
        }.items():
            if value is not None:
                raise UsageError(flag, "applies to two frames; omit it, or --clip")
    elif not (start is None and stop is None and length is None):
        raise UsageError("--clip", "--start, --stop and --length need a clip")
    if model is None and (attacks is not None or given["still"]):
        raise UsageError("--model", "--attacks and --still need a model")
    if given["still"] and attacks is not None:
        raise UsageError("--still", "shows phantom motion under corruptions; omit --attacks")
    wanted = names(given["corruptions"])
    if attacks is not None and wanted is None:
        refuse_unused(context, {"severity_scale", "psf_dir", "depth", "focal"}, "with --attacks alone")
    check_severity(given["severity"])
    if wanted is not None:
        from ..corruptions import IMAGE_PAIR, PAPER_ORDER, corruption_name
        from ..corruptions.registry import with_families

        possible = IMAGE_PAIR if clip is None else PAPER_ORDER
        wanted = [corruption_name(name) for name in with_families(wanted, possible)]
    output = given["output"] or Path("gallery")
    shown = _GalleryRequest(wanted, given["severity"], given["severity_scale"], given["seed"], output)
    if attacks is not None:
        shown.write_attacks(_sample_of(frames)[0], names(attacks) or [], model)
        if wanted is None:
            return
    if clip is None:
        shown.write_pair(frames, model, given["depth"], given["focal"], given["still"])
    else:
        shown.write_clip(clip, start, stop, length)


def _sample_of(frames: tuple[Path, Path] | None) -> "tuple[Sample, str]":
    """Return the pair and its name."""
    from ..core.types import Sample
    from ..data.datasets import load_dataset
    from ..media.images import read_image

    if frames is None:
        return load_dataset("motorcycle", None).load("motorcycle"), "the motorcycle pair"
    pair = read_image(frames[0]), read_image(frames[1])
    return Sample(frames[0].stem, pair), f"{frames[0].name}, {frames[1].name}"


@dataclass(frozen=True)
class _GalleryRequest:
    """What a gallery shows, and where it is written; `corruptions` is None for all of them."""

    corruptions: list[str] | None
    severity: int
    scale: str
    seed: int
    output: Path

    def write_pair(
        self, frames: tuple[Path, Path] | None, model: str | None, depth: Path | None, focal: float | None, still: bool
    ) -> None:
        from ..core.arguments import SEVERITIES
        from ..data.benchmarks.paper import DEMO_CLASSES
        from ..data.datasets.still import still_scene
        from ..report.gallery.page import gallery_slider, page_of
        from ..report.gallery.pictures import gallery as cells_of

        sample, what = _sample_of(frames)
        if still:
            sample, what = still_scene(sample, 0), f"a frame from {what}"
        classes = DEMO_CLASSES if frames is None else {}
        sample = replace(sample, depth=self._depth(frames, sample, depth, focal))
        cells = list(cells_of(sample, SEVERITIES, self.corruptions, self.seed, self.scale, classes))
        title = f"Corruptions of {what}, {self.scale} scale"
        at = [cell for cell in cells if cell.severity == self.severity]
        slider = gallery_slider(title, sample.frames[:1], cells, SEVERITIES, self.severity)
        self._write_gallery(sample.frames[0], at, title, page_of(slider))
        if model is not None:
            self._write_strip(sample, model, [cell.name for cell in at if cell.ssim is not None], classes)

    def _depth(
        self, frames: tuple[Path, Path] | None, sample: "Sample", depth: Path | None, focal: float | None
    ) -> "SceneDepth | None":
        """Return the depth of the pair if a corruption needs it."""
        from ..data.benchmarks import Benchmark
        from ..data.benchmarks.registry import with_own_depth
        from ..data.datasets import load_dataset
        from ..run.predict import frames_of

        dataset = load_dataset("motorcycle") if frames is None else frames_of(list(frames), {})
        pair = Benchmark("gallery", dataset, (sample.key,), tuple(self.corruptions or ()))
        depths = with_own_depth(pair, depth, focal).depth_to_read()
        return None if depths is None else depths.depth(sample)

    def write_attacks(self, sample: "Sample", attacks: list[str], model: str) -> None:
        from ..attacks import attack, load_attack
        from ..attacks.api import with_controls
        from ..models import load_model
        from ..report.gallery.strip import draw_attacks

        loaded, (first, second) = load_model(model), sample.frames
        options: dict[str, Any] = {"flow": sample.flow, "valid": sample.valid, "seed": self.seed, "key": sample.key}
        chosen = [load_attack(name) for name in with_controls(attacks)]
        attacked = [attack(first, second, loaded, each, severity=self.severity, **options) for each in chosen]
        self._write("attacks.webp", draw_attacks(first, attacked, model))

    def _write_strip(
        self, sample: "Sample", model: str, corruptions: list[str], classes: "Mapping[str, type[Corruption]]"
    ) -> None:
        from ..corruptions import load_corruption
        from ..models import load_model
        from ..models.base import FlowModel
        from ..report.gallery.strip import draw_strip, strip_columns

        loaded = load_model(model)
        if not isinstance(loaded, FlowModel):
            raise UsageError(model, "does not predict from two frames, which the strip requires")
        chosen = [load_corruption(name, scale=self.scale, classes=classes) for name in corruptions]
        columns = strip_columns(sample, loaded.predict, chosen, self.severity, self.seed)
        self._write("strip.webp", draw_strip(sample, columns, model))

    def write_clip(self, clip: Path, start: str | None, stop: str | None, length: int | None) -> None:
        from tempfile import TemporaryDirectory

        from ..core.arguments import SEVERITIES
        from ..core.display import ProgressBar
        from ..report.gallery.page import gallery_slider, page_of
        from ..report.gallery.pictures import SHOWN, ClipPart, chosen_corruptions, clip_cells

        chosen, remarks = chosen_corruptions(self.corruptions, self.scale)
        part = ClipPart(clip, start, stop, SHOWN if length is None else length)
        frames = list(part.frames(part.shown))
        key = clip.resolve().stem
        first, last = part.first_number, part.first_number + len(frames) - 1
        title = f"Corruptions of {clip.name}, frames {first} to {last}, {self.scale} scale"
        at: list[GalleryCell] = []

        def collect(cells: "Iterable[GalleryCell]") -> "Iterator[GalleryCell]":
            for cell in cells:
                if cell.severity == self.severity:
                    at.append(cell)
                yield cell

        with TemporaryDirectory(prefix="robustflow-gallery-") as folder, ProgressBar() as progress:
            cells = clip_cells(part, frames, SEVERITIES, chosen, Path(folder), self.seed, key, self.scale)
            tracked = progress.track(cells, f"{clip.name}: corrupting", len(chosen) * len(SEVERITIES))
            slider = gallery_slider(title, frames, collect(tracked), SEVERITIES, self.severity, first)
        about = f"{part.count} frames at {float(part.rate):.4g} frames per second; SSIM of the first corrupted frame"
        self._write_gallery(frames[0], at, title, page_of(slider, [about, *remarks]))
        for remark in remarks:
            typer.echo(remark, err=True)

    def _write_gallery(self, clean: "Frame", at: "Sequence[GalleryCell]", title: str, page: str) -> None:
        from ..report.gallery.page import draw_figure

        for form in ("png", "pdf"):
            self._write(f"gallery.{form}", draw_figure(clean, at, f"{title}, severity {self.severity}", form))
        self._write("gallery.html", page.encode())

    def _write(self, name: str, data: bytes) -> None:
        from ..core.files import make_folder, write_bytes

        make_folder(self.output)
        write_bytes(self.output / name, data)
        typer.echo(str(self.output / name))
