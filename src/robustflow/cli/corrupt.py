"""`robustflow corrupt`: apply corruptions to your own pair of frames."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.errors import UsageError
from ..core.files import make_folder
from ..core.output import echo
from .options import DEPTH, FRAMES, depth_of, names, numbers, refuse_unused, shared


@shared(
    *FRAMES,
    *DEPTH,
    corruptions="Comma-separated names, families (weather), stacks (fog+snow), or your own module.path:Attribute.",
    severities="1 (mild) to 5 (severe), e.g. 3 or 1-5; 3 by default.",
    output="Folder for the corrupted frames; 'corrupted' by default.",
)
def corrupt(
    context: typer.Context,
    frame1: Annotated[Path | None, Argument(metavar="FRAME1", help="First frame.")] = None,
    frame2: Annotated[Path | None, Argument(metavar="FRAME2", help="Second frame; same size as the first.")] = None,
    check: Annotated[bool, Option("--check", help="Only check that this machine makes the reference bytes.")] = False,
    **given: Any,
) -> None:
    """Corrupt two frames and write them as <corruption>_<severity>/<frame's name>.png.

    \b
    Examples:
      robustflow corrupt a.png b.png -c snow,frost -s 1,3,5 --seed 7 -o corrupted
      robustflow corrupt --check
    """
    if check:
        refuse_unused(context, set(context.params) - {"check"}, "with --check")
        _check_machine()
        return
    from ..corruptions import IMAGE_PAIR, corruption_name, load_corruption
    from ..corruptions import corrupt as corrupt_pair
    from ..corruptions.registry import with_families
    from ..media.images import write_image
    from ..run.predict import frames_of

    if frame1 is None or frame2 is None or given["corruptions"] is None:
        raise UsageError("--corruptions", "give two frames and --corruptions, or --check alone")
    wanted = with_families(names(given["corruptions"]) or [], IMAGE_PAIR)
    chosen = [load_corruption(corruption_name(name), given["variant"], given["severity_scale"]) for name in wanted]
    levels = numbers(given["severities"] or "3") or []
    for corruption in chosen:
        for level in levels:
            corruption.parameter(level)
    dataset = frames_of([frame1, frame2], {})
    sample = dataset.load(frame1.stem)
    scene = depth_of(sample, dataset, (corruption.name for corruption in chosen), given)
    stems = (frame1.stem, frame2.stem) if frame1.stem != frame2.stem else (f"{frame1.stem}_1", f"{frame2.stem}_2")
    for corruption in chosen:
        for level in levels:
            folder = (given["output"] or Path("corrupted")) / f"{corruption.name}_{level}"
            make_folder(folder)
            corrupted = corrupt_pair(*sample.frames, corruption, level, given["seed"], sample.key, depth=scene)
            for stem, frame in zip(stems, corrupted, strict=True):
                write_image(folder / f"{stem}.png", frame)
            echo(str(folder))


def _check_machine() -> None:
    """Print a line for every corruption whose result differs on this machine; exit with 1 if there are any."""
    from ..corruptions.machine_check import compare_with_package
    from ..data.video import machine_check as clips

    compared = [*compare_with_package(), *clips.compare_with_package()]
    for name, difference in compared:
        if difference:
            echo(f"{name}: {difference}")
    same = sum(not difference for _, difference in compared)
    echo(f"{same} of {len(compared)} corruptions match the reference bytes on this machine")
    if same < len(compared):
        raise typer.Exit(1)
