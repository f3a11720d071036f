"""The order of the pairs, which depends only on the seed and the position.

A position counts the pairs of a training from 0: step t, place i of a batch of n is position t * n + i. Neither the
number of loader workers or processes nor the point at which a training was resumed can change which pair is at a
position.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...errors import UsageError
from ...random.rng import Rng


class Order:
    """Every pair once per epoch, shuffled; an incomplete last update of an epoch is left out, as by a loader with
    `drop_last`.

    Args:
        count: places in an epoch.
        block: pairs of one update.
        seed: of the shuffle.

    Raises:
        UsageError: fewer places than one update takes.

    >>> order = Order(count=7, block=3, seed=1)
    >>> first = [order.place(position) for position in range(6)]
    >>> len(set(first)), order.epoch(5), order.epoch(6)
    (6, 0, 1)
    """

    def __init__(self, count: int, block: int, seed: int) -> None:
        if count < block:
            raise UsageError(
                f"{count} pairs are fewer than one update needs ({block}); give more data, or a smaller --batch-size"
            )
        self.count = count
        self.seed = seed
        self._each = count - count % block

    def epoch(self, position: int) -> int:
        """The epoch of a position."""
        return position // self._each

    def place(self, position: int, attempt: int = 0) -> int:
        """The place in an epoch, 0 to `count` - 1, that comes at a position.

        Args:
            position: from 0.
            attempt: 0; from 1 on, the replacement for a pair that cannot be read.
        """
        if attempt:
            return Rng.of(self.seed, "replacement", position, attempt).integer(0, self.count)
        epoch, offset = divmod(position, self._each)
        return int(_shuffled(self.count, self.seed, epoch)[offset])


@lru_cache(maxsize=2)
def _shuffled(count: int, seed: int, epoch: int) -> npt.NDArray[np.int64]:
    return np.argsort(Rng.of(seed, "epoch", epoch).bits(count), kind="stable")
