"""Import what workers need, in the process from which they are forked.

The only threads are those of Polars: of its allocator, which handles forks, and for files that no worker uses.
"""

import gc

from ...core.rng import Rng
from ...corruptions import IMAGE_PAIR, load_corruption
from . import device, processes  # noqa: F401

for _name in IMAGE_PAIR:
    load_corruption(_name)
Rng.of(0).bits(1)  # the first compiled function that runs imports a third of numba
gc.freeze()  # workers need not search all of this for garbage, which would also copy its memory
