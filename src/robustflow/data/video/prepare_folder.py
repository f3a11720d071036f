"""Find all clips in a folder, estimate the disk space, and prepare them in several processes."""

from __future__ import annotations

import multiprocessing
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path

from ...core.display import ProgressBar
from ...core.environment import safe_path
from ...core.errors import DataError, UsageError
from ...core.files import cache_folder, make_folder, sealed, sha256_of_file, write_json
from ...core.paths import folders
from ...media.images import images_in, png_bytes
from .codec import Encoder, even_size, lossless, rgb_to_i420
from .interpolation import FlowInterpolator, interpolate, load_interpolator
from .prepare import Preparation, Progress, clip_timing, prepare_clip
from .prepared import CACHE_LIMIT, FOLDER_MANIFEST, VERSION, FolderManifest, PreparedClip, read_folder, read_manifest
from .source import PictureFolder, Source, VideoFile

SEQUENCES = ("GOPR0374_11_02", "GOPR0379_11_00", "GOPR0384_11_02", "GOPR0385_11_00", "GOPR0386_11_00")
"""The five GoPro sequences used in the paper (appendix, "GoPro-FC")."""

CAMERA_FPS = Fraction(240)


PrepareAll = Callable[[Sequence[Source], Path, Preparation, Progress], None]
"""Prepares every clip in a subfolder of the output folder, named after the clip."""


def find_sources(data: Path, evenly: bool = False) -> list[Source]:
    """Return the clips in `data`: the five GoPro sequences, one video, or one or more folders of images."""
    if data.is_file():
        return [VideoFile(data, evenly=evenly)]
    if not data.is_dir():
        raise DataError(data, "no such file or folder; check the path")
    sequences = {name: path for name in SEQUENCES if (path := _sequence(data, name)) is not None}
    if sequences:
        missing = [name for name in SEQUENCES if name not in sequences]
        if missing:
            raise DataError(data, f"missing GoPro sequences: {', '.join(missing)}; add them or specify one folder")
        return [_camera(sequences[name], name) for name in SEQUENCES]
    if images_in(data):
        return [PictureFolder(data)]
    inner = [folder for folder in folders(data) if images_in(folder)]
    if not inner:
        raise DataError(data, f"contains neither GoPro sequences ({SEQUENCES[0]}, ...) nor (folders of) images")
    return [PictureFolder(folder) for folder in inner]


def prepare_folder(
    sources: Sequence[Source],
    output: Path,
    preparation: Preparation,
    workers: int = 1,
    cache_limit: int = CACHE_LIMIT,
    progress: Progress = lambda clip, what, done, total: None,
    prepare_all: PrepareAll | None = None,
) -> list[PreparedClip]:
    """Prepare all clips in `output`. The number of workers and the machine do not affect the files."""
    if workers < 1:
        raise UsageError("--workers", f"{workers} is invalid; give at least 1")
    load_interpolator(preparation.interpolator, preparation.factor, preparation.checkpoint, preparation.device)
    for source in sources:  # report problems before anything is written
        clip_timing(source, preparation)
    manifest = FolderManifest(version=VERSION, clips=[source.name for source in sources], cache_limit=cache_limit)
    if len(set(manifest.clips)) != len(manifest.clips):
        raise DataError(output, f"several clips have the same name: {', '.join(manifest.clips)}; rename one")
    _claim(output, manifest)
    if prepare_all is not None:
        prepare_all(sources, output, preparation, progress)
    elif workers == 1 or len(sources) == 1:
        for source in sources:
            prepare_clip(source, output / source.name, preparation, progress)
    else:
        _in_processes(sources, output, preparation, workers, progress)
    return read_folder(output)[1]


def prepare_video(path: Path) -> Path:
    """Prepare a video file in the user's cache folder, without interpolation and with key frames 1/30 s apart."""
    sources = find_sources(path)
    output = cache_folder("clips") / f"{sources[0].name}-{sha256_of_file(path)[:12]}-v{VERSION}"
    with ProgressBar() as progress:
        prepare_folder(sources, output, Preparation(factor=1), progress=progress.stage)
    return output


def _in_processes(
    sources: Sequence[Source], output: Path, preparation: Preparation, workers: int, progress: Progress
) -> None:
    context = multiprocessing.get_context("spawn")
    with safe_path(), ProcessPoolExecutor(workers, mp_context=context) as pool:
        tasks = {pool.submit(prepare_clip, s, output / s.name, preparation): s for s in sources}
        try:
            for finished, task in enumerate(as_completed(tasks), start=1):
                task.result()
                progress(tasks[task].name, "clips", finished, len(sources))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _claim(output: Path, manifest: FolderManifest) -> None:
    make_folder(output)
    path = output / FOLDER_MANIFEST
    if path.is_file() and read_manifest(path, FolderManifest).clips != manifest.clips:
        raise DataError(output, "contains different prepared clips; choose a different --output")
    write_json(path, sealed(manifest.model_dump()))


def _sequence(data: Path, name: str) -> Path | None:
    return next((data / part / name for part in ("", "train", "test") if (data / part / name).is_dir()), None)


def _camera(folder: Path, name: str) -> PictureFolder:
    if not images_in(folder) and any((folder / kind).is_dir() for kind in ("sharp", "blur")):
        raise DataError(folder, "GoPro_Large lacks frames; GoPro-FC needs GOPRO_Large_all, at 240 frames per second")
    source = PictureFolder(folder, name)
    source.fps = CAMERA_FPS
    return source


PROBE = 8
"""Number of source frames encoded for the estimate."""


@dataclass(frozen=True)
class DiskEstimate:
    """Bytes required permanently, additional bytes required while the largest clip is prepared, and free bytes."""

    kept: int
    temporary: int
    variants: int
    free: int

    def __str__(self) -> str:
        return (
            f"about {_gb(self.kept)} permanently, {_gb(self.temporary)} more during preparation, "
            f"later up to {_gb(self.variants)} for transcoded variants; {_gb(self.free)} free"
        )


def estimate_disk(
    sources: Sequence[Source], output: Path, preparation: Preparation, cache_limit: int, workers: int = 1
) -> DiskEstimate:
    """Estimate the disk space from the first `PROBE` frames of every clip, always using the interpolator "flow"."""
    kept, segments, variants = 0, [0], 0
    for source in sources:
        timing = clip_timing(source, preparation)
        coded, picture = _bytes_per_frame(source, preparation.factor)
        kept += timing.count * coded + len(timing.key_frames) * picture
        variants += 15 * len(timing.key_frames) * picture
        segments.append(timing.count * coded if preparation.factor > 1 else 0)
    temporary = sum(sorted(segments)[-workers:])
    return DiskEstimate(kept, temporary, min(variants, cache_limit), _free(output))


def check_room(estimate: DiskEstimate, output: Path) -> None:
    if estimate.kept + estimate.temporary > estimate.free:
        raise DataError(output, f"not enough disk space: {estimate}; choose a different --output or fewer clips")


def _bytes_per_frame(source: Source, factor: int) -> tuple[int, int]:
    probe = list(islice(source.frames(), PROBE))
    frames = list(interpolate(probe, FlowInterpolator(), factor)) if factor > 1 else probe
    height, width = even_size(*source.size)
    encoder = Encoder(height, width, Fraction(240), lossless("ultrafast"))
    packets = encoder.encode((index, rgb_to_i420(frame)) for index, frame in enumerate(frames))
    coded = sum(len(packet.data) for packet in packets) // len(frames)
    return coded, len(png_bytes(probe[0]))


def _free(output: Path) -> int:
    existing = next(folder for folder in (output.absolute(), *output.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free


def _gb(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 5e7 else f"{count / 1e6:.1f} MB"
