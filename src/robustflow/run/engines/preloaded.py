"""Import what workers need, in the process from which they are forked.

The only threads are those of Polars: of its allocator, which handles forks, and for files that no worker uses.
"""

import gc

gc.disable()  # searching for garbage takes a sixth of the time of these imports

from ...core.rng import Rng  # noqa: E402
from ...corruptions import IMAGE_PAIR, load_corruption  # noqa: E402
from . import device, processes  # noqa: E402, F401

for _name in IMAGE_PAIR:
    load_corruption(_name)
Rng.of(0).bits(1)  # the first compiled function that runs imports a third of numba
gc.enable()
gc.freeze()  # workers need not search all of this for garbage, which would also copy its memory
