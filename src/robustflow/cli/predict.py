"""`robustflow predict`: predict the flow of frames or of a clip."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.display import ProgressBar
from ..core.errors import UsageError
from ..core.output import echo
from .options import MODEL, keyword_options, model_options, refuse_unused, shared


@shared(*MODEL, "data_options", output="Folder for the flows; 'flows' by default.")
def predict(
    context: typer.Context,
    frames: Annotated[
        list[Path], Argument(metavar="FRAMES", help="Two or more images, a folder of images, or a video.")
    ],
    suffix: Annotated[str, Option("--format", help="flo (Middlebury), png (KITTI), pfm, or flo5 (Spring).")] = "flo",
    pictures: Annotated[bool, Option("--pictures/--no-pictures", help="Write a colour picture of each flow.")] = True,
    radius: Annotated[
        float | None,
        Option(
            "--max-flow", metavar="PX", help="Flow shown in full colour, in pixels; the 99th percentile by default."
        ),
    ] = None,
    video: Annotated[Path | None, Option(metavar="FILE.mp4", help="Write a video of frames and flow.")] = None,
    fps: Annotated[float, Option(help="Frames per second of --video.")] = 25.0,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace flows that already exist.")] = False,
    **given: Any,
) -> None:
    """Predict the flow of each pair of adjacent frames, and write it in a standard file format.

    \b
    Examples:
      robustflow predict a.png b.png
      robustflow predict --model raft --checkpoint things frames/ -o flows --format png
      robustflow predict --model farneback clip.mp4 --video flow.mp4 --no-pictures
    """
    from ..models import ModelRef
    from ..run.predict import frames_of, predict_flows, write_pictures, write_video

    if video is None:
        refuse_unused(context, {"fps"} if pictures else {"fps", "radius"}, "without --video")
    if radius is not None and not 0 < radius < float("inf"):
        raise UsageError("--max-flow", f"{radius}: give a magnitude above 0 pixels")
    if not 0.01 <= fps <= 1000:
        raise UsageError("--fps", f"{fps}: give a number from 0.01 to 1000")
    if video is not None and video.suffix.lower() != ".mp4":
        raise UsageError("--video", f"{video}: the name must end in .mp4")
    if video is not None and video.exists() and not overwrite:
        raise UsageError(video, "already exists; choose another name, or give --overwrite")
    ref = ModelRef.parse(given["model"] or "dis", model_options(given))
    dataset = frames_of(frames, dict(keyword_options(given["data_options"])))
    output, total = given["output"] or Path("flows"), len(dataset.keys())
    with ProgressBar() as progress:
        flows = predict_flows(ref, dataset, output, suffix=suffix, overwrite=overwrite)
        done = list(progress.track(flows, f"{output}: predicting", total))
        longest = radius if radius is not None else max(prediction.radius for prediction in done)
        if pictures:
            list(progress.track(write_pictures(done, longest), f"{output}: drawing", total))
        if video is not None:
            write_video(video, done, dataset, longest, fps)
    for written in filter(None, (output, video)):
        echo(str(written))
