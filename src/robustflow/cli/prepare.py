"""`robustflow prepare`: prepare a benchmark's data from recordings, or list the digests of a dataset."""

import re
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from ..core.display import ProgressBar
from ..core.errors import DataError, UsageError, unknown_name
from ..core.output import echo
from ..core.text import counted
from .options import refuse_unused, shared

if TYPE_CHECKING:
    from ..data.video.prepare_folder import PrepareAll

app = typer.Typer(no_args_is_help=True)


@app.command("gopro-fc")
@shared(
    "engine",
    "address",
    workers="Clips to prepare in parallel; 1 by default, or with Ray, as many as fit in the cluster.",
)
def gopro_fc(
    context: typer.Context,
    data: Annotated[
        Path, Option("--data", "-d", help="GOPRO_Large_all, a video file, a folder of frames, or a folder of these.")
    ],
    output: Annotated[Path, Option("--output", "-o", help="Folder for masters and key frames.")],
    fps: Annotated[str | None, Option(help="Frames per second; 240 for GoPro; a video states its own.")] = None,
    factor: Annotated[int, Option(help="Factor by which interpolation raises the frame rate; 1 for none.")] = 4,
    step: Annotated[int | None, Option(help="Master frames per key frame; by default for 30 pairs per second.")] = None,
    interpolator: Annotated[str | None, Option(help="flavr (with --checkpoint) or flow (DIS, no weights).")] = None,
    checkpoint: Annotated[Path | None, Option(help="FLAVR's official 4x weights.")] = None,
    device: Annotated[str, Option(help="Device for FLAVR: cpu, cuda, cuda:0.")] = "cpu",
    preset: Annotated[str, Option(help="x264 preset of the master video; affects only bit errors.")] = "veryslow",
    cache_gb: Annotated[float, Option(help="Cache limit in GB for the transcoded variants made during a run.")] = 20.0,
    estimate_only: Annotated[bool, Option("--estimate", help="Print the required disk space and exit.")] = False,
    **given: Any,
) -> None:
    """Convert clips to 4x frame rate, a lossless master video, and pairs of key frames. If interrupted, run the same
    command again to continue.

    \b
    Examples:
      robustflow prepare gopro-fc -d GOPRO_Large_all -o gopro-fc --interpolator flavr --checkpoint FLAVR_4x.pth
      robustflow prepare gopro-fc -d clip.mp4 -o mine --interpolator flow
      robustflow prepare gopro-fc -d /shared/GoPro -o /shared/gopro-fc --interpolator flow --engine ray --address auto
    """
    from ..data.video.prepare import Preparation
    from ..data.video.prepare_folder import check_room, estimate_disk, find_sources, prepare_folder

    if interpolator == "flow":
        refuse_unused(context, {"checkpoint", "device"}, "with --interpolator flow")
    rate = _rate(fps)
    preparation = Preparation(rate, factor, step, interpolator, checkpoint, device, preset)
    if not 0 <= cache_gb < float("inf"):
        raise UsageError("--cache-gb", f"{cache_gb:g}: give 0 or more")
    limit = round(cache_gb * 1e9)
    workers = given["workers"]
    prepare_all = _ray_preparation(given["engine"] or "processes", workers, given["address"])
    sources = find_sources(data, evenly=rate is not None)
    at_once = workers or (1 if prepare_all is None else len(sources))
    estimate = estimate_disk(sources, output, preparation, limit, at_once)
    typer.echo(str(estimate), err=True)
    if estimate_only:
        return
    check_room(estimate, output)
    with ProgressBar() as progress:
        clips = prepare_folder(sources, output, preparation, workers or 1, limit, progress.stage, prepare_all)
    pairs = sum(len(clip.pairs) for clip in clips)
    counts = f"{counted(len(clips), 'clip')}, {counted(pairs, 'pair')}"
    echo(f"{output}: {counts}; next: robustflow run --benchmark gopro-fc --data {output}")


@app.command("digests")
def digests(
    data: Annotated[Path, Option("--data", "-d", help="Folder of the dataset.")],
    overwrite: Annotated[bool, Option("--overwrite", help="Rewrite the list after files have changed.")] = False,
) -> None:
    """Write a list of the digests of a dataset's files, or verify the files against an existing list.

    The list, digests.b2sum, is stored in the folder and copied with it. 'robustflow run' verifies every file that it
    reads, because many formats (.flo, PPM, BMP) cannot detect a changed byte. b2sum --check digests.b2sum does the
    same.

    \b
    Example:
      robustflow prepare digests --data ~/kitti
    """
    from ..run.data_files import DIGEST_LIST, digests_in, listed_files, read_list, write_list

    if not data.is_dir():
        raise DataError(data, "no such folder; give the folder of the dataset")
    before = read_list(data) if not overwrite and (data / DIGEST_LIST).exists() else None
    names = listed_files(data)
    if not names:
        raise DataError(data, "contains no files; give the folder of the dataset")
    with ProgressBar() as progress:
        digests = dict(progress.track(digests_in(data, names), f"{data}: reading", len(names)))
    if before is None:
        path = write_list(data, digests)
        echo(f"{path}: {counted(len(digests), 'file')}; 'robustflow run' verifies files against this list")
        return
    differing = [name for name, digest in before.items() if digests.get(name) != digest]
    if differing:
        state = "has changed" if differing[0] in digests else "is missing"
        of = f"{len(differing)} of {counted(len(before), 'listed file')} differ"
        raise DataError(data / differing[0], f"{state} ({of}); copy the data again, or give --overwrite")
    echo(f"{counted(len(before), 'file')}: no differences from {data / DIGEST_LIST}")
    if added := len(digests) - len(before):
        echo(f"{counted(added, 'file')} are not listed; --overwrite adds them")


def _ray_preparation(engine: str, workers: int | None, address: str | None) -> "PrepareAll | None":
    if engine not in ("processes", "ray"):
        raise unknown_name("engine", engine, ("processes", "ray"))
    if engine == "processes":
        if address is not None:
            raise UsageError("--address", "requires --engine ray; give both, or leave it out")
        return None
    if workers is not None and workers < 1:
        raise UsageError("--workers", f"{workers}: give 1 or more")
    from ..run.engines.ray_prepare import prepare_on_ray

    return partial(prepare_on_ray, workers=workers, address=address)


def _rate(text: str | None) -> Fraction | None:
    """Parse a frame rate, and round it to a denominator of at most 1001.

    >>> _rate("29.97003"), _rate("24000/1001"), _rate(None)
    (Fraction(30000, 1001), Fraction(24000, 1001), None)
    """
    if text is None:
        return None
    number = re.fullmatch(r"\d{1,6}(\.\d{1,20})?|\d{1,9}/[1-9]\d{0,8}", text.strip(), re.ASCII)
    rate = Fraction(text).limit_denominator(1001) if number else Fraction(0)
    if not 0 < rate < 10**6:
        raise UsageError("--fps", f"{text} is not a frame rate: give a number such as 240 or 30000/1001")
    return rate
