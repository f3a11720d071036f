"""Measure the frames per second of every video stage at 720p on one core, and compare encoding with the ffmpeg program.

    python bench/video.py [--frames 48] [--preset veryslow] [--ffmpeg /usr/bin/ffmpeg]

CPU seconds are measured for both, so that other load on the machine has little influence.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
from skimage import data

from robustflow.data.video.clip import ClipFile, read_pictures, write_clip
from robustflow.data.video.codec import Options, abr, crf, encoder_versions, i420_to_rgb, lossless, rgb_to_i420
from robustflow.data.video.interpolation import FlowInterpolator
from robustflow.data.video.open_clip import mean_of_windows
from robustflow.data.video.variants import corrupted_stream

HEIGHT, WIDTH, FPS = 720, 1280, Fraction(960)


def frames(count: int) -> list[np.ndarray]:
    """A slow pan over a photograph with sensor noise, similar to high-frame-rate footage."""
    image = np.tile(np.asarray(data.astronaut()), (2, 4, 1))
    rng = np.random.default_rng(0)
    noise = [rng.normal(0, 1.5, (HEIGHT, WIDTH, 1)) for _ in range(8)]
    shifted = (image[i // 2 : i // 2 + HEIGHT, i : i + WIDTH] for i in range(count))
    return [np.clip(np.rint(frame + noise[i % 8]), 0, 255).astype(np.uint8) for i, frame in enumerate(shifted)]


def rate(count: int, work: Callable[[], object]) -> float:
    """Frames per second of CPU time, for this process and its children."""
    before = _cpu()
    work()
    return count / max(_cpu() - before, 1e-9)


def _cpu() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def by_program(ffmpeg: str, raw: Path, out: Path, encoding: Options) -> Callable[[], object]:
    """Encode with the ffmpeg program, in one thread."""
    options = [part for name, value in encoding.items() for part in (f"-{name}", value)]
    source = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "yuv420p",
        "-s",
        f"{WIDTH}x{HEIGHT}",
        "-framerate",
        str(FPS),
        "-i",
        str(raw),
    ]
    command = [ffmpeg, "-y", "-v", "error", *source, "-c:v", "libx264", "-threads", "1", *options, str(out)]
    return lambda: subprocess.run(command, check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=48, help="32 to 600")
    parser.add_argument("--preset", default="veryslow")
    parser.add_argument("--ffmpeg", default=shutil.which("ffmpeg"))
    args = parser.parse_args()
    count = args.frames
    if not 32 <= count <= 600:
        parser.error(f"--frames {count}: give 32 to 600")
    rgb = frames(count)
    pictures = [rgb_to_i420(frame) for frame in rgb]
    print(f"{WIDTH}x{HEIGHT}, {count} frames, one thread, CPU time; {encoder_versions()}")
    with tempfile.TemporaryDirectory() as folder:
        path, raw = Path(folder) / "a.mp4", Path(folder) / "a.yuv"
        raw.write_bytes(b"".join(picture.tobytes() for picture in pictures))
        for encoding in (crf(23), crf(51), abr(3_125_000), lossless("ultrafast"), lossless(args.preset)):
            name = f"crf {encoding['crf']} {encoding.get('preset', 'medium')}" if "crf" in encoding else "abr medium"
            ours = rate(count, lambda e=encoding: write_clip(path, pictures, (HEIGHT, WIDTH), FPS, e))
            line = f"{f'encode {name}':36s} {ours:7.1f} frames/s"
            if args.ffmpeg:
                theirs = rate(count, by_program(args.ffmpeg, raw, path.with_name("b.mp4"), encoding))
                line += f", ffmpeg {theirs:7.1f}, ours / theirs {ours / theirs:.2f}"
            print(line, flush=True)
        clip = ClipFile(path, count, FPS, HEIGHT, WIDTH)
        print(f"{'size of the master per frame':36s} {os.path.getsize(path) / count / 1e6:7.3f} MB")
        stages: list[tuple[str, int, Callable[[], object]]] = [
            ("decode the master", count, lambda: sum(1 for _ in read_pictures(clip))),
            ("bit errors, N = 1 M", count, lambda: sum(1 for _ in corrupted_stream(clip, "bit_error", 10**6).pictures)),
            ("RGB to I420", count, lambda: [rgb_to_i420(frame) for frame in rgb]),
            ("I420 to RGB", count, lambda: [i420_to_rgb(picture, HEIGHT, WIDTH) for picture in pictures]),
            ("interpolate 4x by flow (new frames)", 6, lambda: [FlowInterpolator().between(rgb[:4], 4) for _ in "ab"]),
            ("object motion blur (5 severities)", 1, lambda: mean_of_windows(rgb.__getitem__, 16, (3, 6, 9, 12, 15))),
        ]
        for name, done, work in stages:
            print(f"{name:36s} {rate(done, work):7.1f} frames/s", flush=True)


if __name__ == "__main__":
    main()
