"""Compare the time for augmenting a training pair with that of the original implementation.

    python bench/augmentation.py [--rounds 40]

The script prints CPU milliseconds per pair with one thread: the mean over the draws of a round, for the best of three
rounds. Both implementations apply the same draws: ours as in `train`, the original as in RAFT's loader, with
torchvision's colour jitter on Pillow images, OpenCV's resize of the full frame, and NumPy's scattering of sparse
points. The script first checks that the frames are byte-identical.
"""

from __future__ import annotations

import os

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)

import argparse
import time
from typing import Any

import cv2
import numpy as np
from PIL import Image
from torchvision.transforms import functional as F

from robustflow.core.rng import Rng
from robustflow.testing import TexturePairs
from robustflow.training.augmentation.augment import Augmentation, apply_augmentation, draw_augmentation
from robustflow.training.recipe import Part, mix_parts

CASES = (("Sintel", "ood", 0, (436, 1024), (368, 768)), ("KITTI", "id", 0, (375, 1242), (288, 960)))
"""Title, mix, part of the mix, frame size (H, W), crop size."""


def as_the_originals(frames: Any, flow: Any, valid: Any, drawn: Augmentation) -> Any:
    """RAFT's loader with given draws."""
    first, second = _jittered(frames, drawn.jitters)
    if drawn.rectangles:
        colour = np.mean(second.reshape(-1, 3), axis=0)
        for left, top, width, height in drawn.rectangles:
            second[top : top + height, left : left + width] = colour
    geometry = drawn.geometry
    if geometry.scale is not None:
        x, y = geometry.scale
        first, second = (cv2.resize(frame, None, fx=x, fy=y) for frame in (first, second))
        if drawn.sparse:
            flow, valid = _scattered(flow, valid, x, y)
        else:
            flow = cv2.resize(flow, None, fx=x, fy=y) * [x, y]
    if geometry.mirrored:
        first, second, flow = first[:, ::-1], second[:, ::-1], flow[:, ::-1] * [-1, 1]
        valid = valid[:, ::-1]
    if geometry.upside_down:
        first, second, flow = first[::-1], second[::-1], flow[::-1] * [1, -1]
    rows = slice(geometry.top, geometry.top + drawn.crop[0])
    columns = slice(geometry.left, geometry.left + drawn.crop[1])
    valid = valid[rows, columns] if drawn.sparse else np.ones(drawn.crop, bool)
    arrays = (first[rows, columns], second[rows, columns], flow[rows, columns].astype(np.float32))
    return tuple(np.ascontiguousarray(array) for array in (*arrays, valid))


def _jittered(frames: Any, jitters: Any) -> Any:
    if len(jitters) == 2:
        return [_one_jitter(frame, jitter) for frame, jitter in zip(frames, jitters, strict=True)]
    return np.split(_one_jitter(np.concatenate(frames), jitters[0]), 2)


def _one_jitter(image: Any, jitter: Any) -> Any:
    picture = Image.fromarray(image)
    for operation in jitter.order:
        picture = getattr(F, f"adjust_{operation}")(picture, getattr(jitter, operation))
    return np.array(picture, dtype=np.uint8)


def _scattered(flow: Any, valid: Any, x: float, y: float) -> Any:
    height, width = round(flow.shape[0] * y), round(flow.shape[1] * x)
    columns, rows = np.meshgrid(np.arange(flow.shape[1]), np.arange(flow.shape[0]))
    known = valid.reshape(-1) >= 1
    places = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float32)[known] * [x, y]
    vectors = flow.reshape(-1, 2)[known] * [x, y]
    column, row = np.round(places[:, 0]).astype(np.int32), np.round(places[:, 1]).astype(np.int32)
    inside = (column > 0) & (column < width) & (row > 0) & (row < height)
    moved, there = np.zeros([height, width, 2], np.float32), np.zeros([height, width], bool)
    moved[row[inside], column[inside]] = vectors[inside]
    there[row[inside], column[inside]] = True
    return moved, there


def ours(frames: Any, flow: Any, valid: Any, drawn: Augmentation) -> Any:
    (first, second), flow, valid = apply_augmentation(frames, flow, valid, drawn)
    return first, second, flow, valid


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=40, help="draws in each of three rounds")
    draws = parser.parse_args().rounds
    cv2.setNumThreads(1)
    print(f"{'':8}{'ours':>10}{'theirs':>10}  milliseconds per pair")
    for title, mix, number, shape, crop in CASES:
        sample = TexturePairs(count=1, size=shape, reach=8, seed=4).load("0")
        part: Part = mix_parts(mix)[number]
        frames = tuple(np.ascontiguousarray(frame) for frame in sample.frames)
        thin = np.random.default_rng(0).random(shape) < (0.2 if part.augmentation == "sparse" else 2.0)
        every = [draw_augmentation(Rng.of("bench", n), part, shape, crop) for n in range(draws)]
        for one in every[:10]:
            for a, b in zip(
                ours(frames, sample.flow, thin, one),
                as_the_originals(frames, sample.flow, thin, one),
                strict=True,
            ):
                np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-4 if a.dtype == np.float32 else 0)
        best = {"ours": np.inf, "theirs": np.inf}
        for _ in range(3):
            for who, way in (("ours", ours), ("theirs", as_the_originals)):
                began = time.process_time()
                for one in every:
                    way(frames, sample.flow, thin, one)
                best[who] = min(best[who], (time.process_time() - began) / draws * 1000)
        print(f"{title:8}{best['ours']:10.1f}{best['theirs']:10.1f}  {best['theirs'] / best['ours']:.2f} times")


if __name__ == "__main__":
    main()
