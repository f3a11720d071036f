"""Blur an image with a PSF that varies over it: tiles blended by triangular windows, convolved by FFT.

The transforms are in float64 on purpose: FFT libraries differ between machines by a few units of the last place, which
in float32 would round about one sample in ten thousand the other way, in float64 fewer than one in 10^11. It costs 1.7
times the transforms' time. Only the kernels' spectra are kept in single precision, which rounds them alike everywhere
and lets the five lenses of one image size share the cache.

Patches of neighbouring nodes overlap, so the transforms are taken apart: along the rows once for a whole column of
nodes, along the columns for each node, and back along the rows for the windowed sum of the column's nodes.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import scipy.fft

from ..sample import Frame
from .psf_field import PsfField
from .threads import allowed_threads
from .tiles import SUPPORT, Axis, grid_of, kernels_at

REACH = SUPPORT // 2


class Sized(Protocol):
    """Anything that says how much memory it takes."""

    @property
    def nbytes(self) -> int:
        """Bytes."""


CachedKernel = TypeVar("CachedKernel", bound=Sized)


class KernelCache(Generic[CachedKernel]):
    """What was computed from kernels, by (field, image size); the least recently used go, to keep within a limit."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._entries: OrderedDict[tuple[str, int, int], CachedKernel] = OrderedDict()
        self._nbytes = 0
        self._lock = threading.Lock()

    def get(self, key: tuple[str, int, int]) -> CachedKernel | None:
        """What is kept under a key, or None."""
        with self._lock:
            if key in self._entries:
                self._entries.move_to_end(key)
            return self._entries.get(key)

    def put(self, key: tuple[str, int, int], entry: CachedKernel) -> None:
        """Keep something, unless it alone exceeds the limit."""
        if entry.nbytes > self.limit:
            return
        with self._lock:
            before = self._entries.pop(key, None)
            self._entries[key] = entry
            self._nbytes += entry.nbytes - (before.nbytes if before is not None else 0)
            while self._nbytes > self.limit:
                self._nbytes -= self._entries.popitem(last=False)[1].nbytes

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        with self._lock:
            return self._nbytes


CACHE: KernelCache[npt.NDArray[np.complex64]] = KernelCache(limit=192 * 2**20)


def _spectra(field: PsfField, rows: Axis, columns: Axis, transform: int, column: int) -> npt.NDArray[np.complex64]:
    """Spectra of the kernels of a column of nodes, (rows of nodes, 3, N, N / 2 + 1)."""
    dy = rows.offsets
    kernels = np.empty((dy.size, 3, SUPPORT, SUPPORT))
    corner = math.hypot(rows.length, columns.length) / 2.0
    kernels_at(field.stack, np.full(dy.size, columns.offsets[column]), dy, corner, kernels)
    return np.asarray(scipy.fft.rfft2(kernels, (transform, transform)), np.complex64)


def reflected(length: int, margin: int) -> npt.NDArray[np.intp]:
    """Indices that extend an axis by `margin` on both sides, mirrored about its end pixels (reflect-101)."""
    period = max(2 * (length - 1), 1)
    place = np.abs(np.arange(-margin, length + margin)) % period
    return np.minimum(place, period - place) if length > 1 else np.zeros_like(place)


def blur(frame: Frame, field: PsfField, threads: int | None = None) -> npt.NDArray[np.float64]:
    """Convolve an image with the PSF of each of its points.

    The image's centre takes field 0, its corners field 1, whatever its size; beyond its edges it is continued by
    reflection (reflect-101). Kernels add up to one, so that a flat image stays flat.

    Args:
        frame: RGB uint8 (H, W, 3), any size.
        field: the PSFs.
        threads: how many threads; None for one, or as many as `blur_threads` allows. The result does not depend on it.

    Returns:
        float64 (H, W, 3) in grey levels, not rounded.
    """
    height, width = frame.shape[:2]
    pitch, transform = grid_of(height, width)
    window = 2 * pitch
    rows, columns = Axis.of(height, pitch), Axis.of(width, pitch)
    margin_y, margin_x = (axis.starts[-1] + transform - REACH - axis.length for axis in (rows, columns))
    planes = np.ascontiguousarray(frame.transpose(2, 0, 1))
    padded = planes[:, reflected(height, margin_y)][:, :, reflected(width, margin_x)]
    mirrored = np.stack([padded, padded[..., ::-1]])

    key = (field.digest, height, width)
    cached = CACHE.get(key)
    nodes = len(rows.starts), len(columns.starts)
    size = nodes[0] * nodes[1] * 3 * transform * (transform // 2 + 1) * 8
    fill = None
    if cached is None and size <= CACHE.limit:
        fill = np.empty((nodes[1], nodes[0], 3, transform, transform // 2 + 1), np.complex64)

    def strip(column: int) -> npt.NDArray[np.float64]:
        """The windowed contribution of a column of nodes to the image and its left-right mirror image."""
        if cached is not None:
            spectra = cached[column]
        else:
            spectra = _spectra(field, rows, columns, transform, column)
            if fill is not None:
                fill[column] = spectra
        left = columns.starts[column] + margin_x - REACH
        along_rows = scipy.fft.rfft(mirrored[..., left : left + transform].astype(np.float64), overwrite_x=True)
        sums = np.zeros_like(along_rows)
        patches = np.empty((2, 3, transform, transform // 2 + 1), np.complex128)
        for row, kernels in enumerate(spectra):
            top = rows.starts[row] + margin_y
            kernels = kernels.astype(np.complex128)
            weights = rows.windows[row][:, None]
            for upright in (slice(None), slice(None, None, -1)):
                patches[...] = along_rows[..., upright, :][..., top - REACH : top - REACH + transform, :]
                transformed = scipy.fft.fft(patches, axis=-2, overwrite_x=True)
                transformed *= kernels
                back = scipy.fft.ifft(transformed, axis=-2, overwrite_x=True)[..., 2 * REACH :, :].view(np.float64)
                back *= weights
                sums.view(np.float64)[..., upright, :][..., top : top + window, :] += back
        inside = sums[..., margin_y : margin_y + height, :]
        blurred = scipy.fft.irfft(inside, transform, overwrite_x=True)[..., 2 * REACH :]
        blurred *= columns.windows[column]
        return np.asarray(blurred, np.float64)

    total = np.zeros((3, height, padded.shape[2]))
    for column, (plain, mirror) in enumerate(results_in_order(strip, nodes[1], threads or allowed_threads())):
        left = columns.starts[column] + margin_x
        total[..., left : left + window] += plain
        total[..., ::-1][..., left : left + window] += mirror
    if fill is not None:
        CACHE.put(key, fill)
    return total[..., margin_x : margin_x + width].transpose(1, 2, 0)


def results_in_order(work, count: int, threads: int) -> Iterator[npt.NDArray[np.float64]]:  # type: ignore[no-untyped-def]
    """Results of work(0) .. work(count - 1) in order, at most `threads` + 1 of them alive."""
    if threads == 1:
        yield from (work(number) for number in range(count))
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting = [pool.submit(work, number) for number in range(min(threads, count))]
        for number in range(count):
            yield waiting.pop(0).result()
            if number + threads < count:
                waiting.append(pool.submit(work, number + threads))
