"""Extend an image beyond its border by mirroring, with or without repeating the edge pixel."""

from __future__ import annotations

from ...compiled import inner, njit


@njit(cache=True, nogil=True)
def mirrored(i: int, n: int) -> int:
    """Mirror index `i` on an axis of length `n` at the end pixels, without repeating them."""
    if n == 1:
        return 0
    i = i % (2 * n - 2)
    return min(i, 2 * n - 2 - i)


@inner
def mirrored_with_edge(i: int, n: int) -> int:
    """Mirror index `i` on an axis of length `n`, repeating the end pixels.

    >>> [mirrored_with_edge(i, 3) for i in range(-3, 6)]
    [2, 1, 0, 0, 1, 2, 2, 1, 0]
    """
    i = i % (2 * n)
    return min(i, 2 * n - 1 - i)
