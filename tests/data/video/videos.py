"""Videos like those created by other programs."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np


def video(
    path: Path,
    frames,
    pixels: str = "yuv420p",
    codec: str = "libx264",
    times: list[int] | None = None,
    rotation: int = 0,
    sound: bool = False,
) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options={"crf": "10"} if codec == "libx264" else {})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        if rotation:
            stream.set_display_rotation(rotation)
        audio = container.add_stream("aac", rate=44100, layout="mono") if sound else None
        for index, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=pixels)
            frame.pts, frame.time_base = (times[index] if times else index), Fraction(1, 30)
            container.mux(stream.encode(frame))
            if audio is not None:
                silence = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
                silence.sample_rate, silence.pts = 44100, index * 1024
                container.mux(audio.encode(silence))
        container.mux(stream.encode(None))
        if audio is not None:
            container.mux(audio.encode(None))
    return path


def write_video(path: Path, count: int, gop: int, codec: str = "libx264", index_first=False, **options: str) -> None:
    with av.open(str(path), "w", options={"movflags": "faststart"} if index_first else {}) as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 64, 48, "yuv420p", gop
        y, x = np.mgrid[:48, :64]
        for index in range(count):
            image = np.stack([(x * 3 + index * 5) % 256, (y * 4 + index * 2) % 256, (x + y) % 256], axis=-1)
            for packet in stream.encode(av.VideoFrame.from_ndarray(image.astype(np.uint8), format="rgb24")):
                container.mux(packet)
        container.mux(stream.encode())
