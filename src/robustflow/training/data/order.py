"""Define the order of the pairs, which depends only on the seed and the position.

Positions count the pairs of a training run from 0: place i in the batch of n pairs at step t has the position t * n +
i. The pair at a position does not depend on the number of loader workers or processes, or on when a training run was
resumed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...errors import UsageError
from ...random.rng import Rng


class Order:
    """Shuffle the pairs of each epoch; an incomplete last update of an epoch is dropped, as in a loader with
    `drop_last`.
    """

    def __init__(self, count: int, block: int, seed: int) -> None:
        if count < block:
            raise UsageError(
                f"{count} pairs are too few for one update ({block}); use more data, or a smaller --batch-size"
            )
        self.count = count
        self.seed = seed
        self.updates = count // block
        self._each = self.updates * block

    def place(self, position: int, attempt: int = 0) -> int:
        """Return the place in the epoch, 0 to `count` - 1, for a position."""
        if attempt:
            return Rng.of(self.seed, "replacement", position, attempt).integer(0, self.count)
        epoch, offset = divmod(position, self._each)
        return int(_shuffled(self.count, self.seed, epoch)[offset])


@lru_cache(maxsize=2)
def _shuffled(count: int, seed: int, epoch: int) -> npt.NDArray[np.int64]:
    return np.argsort(Rng.of(seed, "epoch", epoch).bits(count), kind="stable")
