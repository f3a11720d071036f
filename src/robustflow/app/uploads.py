"""Read uploaded frames, ground truth and clips, which are untrusted. Sizes are checked before anything is stored or
decoded."""

from __future__ import annotations

import re
import shutil
from itertools import islice
from pathlib import Path, PurePosixPath, PureWindowsPath

import av
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import Message

from ..core.errors import DataError, RobustFlowError, UsageError
from ..core.paths import VIDEO_SUFFIXES
from ..core.types import Sample
from ..data.datasets.pair_files import read_frames
from ..data.video.container import main_stream, open_video
from ..media.flow import read_flow
from ..media.images import IMAGE_SUFFIXES, stored_size
from ..metrics.photometric import misread_truth
from .sources import PairSource, clip_pairs, one_pair

MAX_BYTES = 64 * 2**20
"""Maximum total size of all files of one upload."""

MAX_PIXELS = 3840 * 2160
"""Maximum number of pixels of a frame."""

MAX_CLIP_FRAMES = 3000

_LONGEST_NAME = 200
"""Number of bytes kept of a file name, from its end; file systems allow 255."""

TRUTH_SUFFIXES = (".flo", ".png", ".pfm")


def limited(request: Request, most: int) -> Request:
    """Make reading a request's body fail after `most` bytes, regardless of the declared length."""
    announced = request.headers.get("content-length", "0")
    if not announced.isdigit() or int(announced) > most:
        raise _too_large(most)
    received = 0

    async def receive() -> Message:
        nonlocal received
        message = await request.receive()
        received += len(message.get("body", b""))
        if received > most:
            raise _too_large(most)
        return message

    return Request(request.scope, receive)


def _too_large(most: int) -> HTTPException:
    size = f"{most // 2**20} MB" if most >= 2**20 else f"{most // 2**10} kB"
    return HTTPException(413, f"more than {size}; reduce its size")


def source_of(form: FormData, folder: Path) -> PairSource:
    """Read a form with `frame1` and `frame2` (and optionally `truth`), or with `clip`. Files are stored in `folder`,
    which is removed when they are no longer needed.
    """
    files = {name: value for name, value in form.multi_items() if isinstance(value, UploadFile)}
    in_use = False
    try:
        if set(files) == {"clip"}:
            clip = _clip(files["clip"], folder)
            in_use = True  # decoded when requested
            return clip
        if {"frame1", "frame2"} <= set(files) <= {"frame1", "frame2", "truth"}:
            return _pair(files, folder)
    except RobustFlowError as error:
        raise type(error)(re.sub(rf"{re.escape(str(folder))}/(?:\w+/)?", "", str(error))) from error
    finally:
        if not in_use:
            shutil.rmtree(folder, ignore_errors=True)
    raise UsageError("frames", "give two, optionally with ground truth, or one clip")


def _pair(files: dict[str, UploadFile], folder: Path) -> PairSource:
    paths = []
    for field in ("frame1", "frame2"):
        path = _saved(files[field], folder / field, IMAGE_SUFFIXES, "an image")
        height, width = stored_size(path)
        if height * width > MAX_PIXELS:
            raise DataError(path, f"{height}x{width} is more than {MAX_PIXELS / 1e6:.1f} megapixels; scale it down")
        paths.append(path)
    frames = read_frames((paths[0], paths[1]))
    name = f"{paths[0].name}, {paths[1].name}"
    if "truth" not in files:
        return one_pair(name, Sample(paths[0].stem, frames))
    truth = _saved(files["truth"], folder / "truth", TRUTH_SUFFIXES, "ground truth")
    if truth.suffix.lower() == ".png" and stored_size(truth) != frames[0].shape[:2]:  # checked before decompression
        height, width = stored_size(truth)
        raise DataError(truth, f"{height}x{width} is not the size of the frames; the files do not match")
    flow, valid = read_flow(truth)
    if not valid.any():
        raise DataError(truth, "no pixel with known flow, so there is nothing to measure against")
    sample = Sample(paths[0].stem, frames, flow, valid)
    if (wrong := misread_truth(sample)) is not None:
        raise DataError(truth, f"its flow looks {wrong.reading.describe()}: {wrong.describe()}; convert it")
    return one_pair(name, sample)


def _clip(file: UploadFile, folder: Path) -> PairSource:
    path = _saved(file, folder / "clip", VIDEO_SUFFIXES, "a video")
    try:
        with open_video(path) as container:
            pixels = max((s.codec_context.width * s.codec_context.height for s in container.streams.video), default=0)
            packets = (packet for packet in container.demux(main_stream(container, path)) if packet.size)
            frames = sum(1 for _ in islice(packets, MAX_CLIP_FRAMES + 1))  # Matroska states no number of frames
    except (av.FFmpegError, ValueError, OSError) as error:
        raise DataError(path, "cannot be read as a video; it may be damaged") from error
    if pixels > MAX_PIXELS or frames > MAX_CLIP_FRAMES:
        most = f"{MAX_CLIP_FRAMES} frames of {MAX_PIXELS / 1e6:.1f} megapixels"
        raise DataError(path, f"clips are limited to {most}; shorten the clip or scale it down")
    return clip_pairs(path.name, path, folder)


def _saved(file: UploadFile, folder: Path, suffixes: tuple[str, ...], what: str) -> Path:
    """Store the file under the last component of the name that the browser sent."""
    name = PureWindowsPath(PurePosixPath(file.filename or "").name).name
    name = "".join(c for c in name if c.isprintable() and c not in '<>:"|?*')
    name = name.encode()[-_LONGEST_NAME:].decode(errors="ignore").lstrip(".") or "unnamed"
    suffix = Path(name).suffix.lower()
    if suffix not in suffixes:
        raise UsageError(name, f"not {what} ({', '.join(suffixes)})")
    folder.mkdir(exist_ok=True)
    path = folder / name
    with open(path, "wb") as out:
        shutil.copyfileobj(file.file, out)
    return path
