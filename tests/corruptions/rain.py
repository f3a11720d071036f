"""A user-defined rain corruption with a parameter defined in a second module."""

import sys
import textwrap
from pathlib import Path

RAIN = textwrap.dedent(
    """
    import numpy as np
    from rain_depth import DEPTH


    class Rain:
        severities = (1, 2, 3, 4, 5)

        def __init__(self, density=1):
            self.density = density

        def draw(self, rng, severity, shape):
            return rng.spawn("drops"), severity * self.density * DEPTH

        def apply(self, frame, state, index):
            rng, depth = state
            return np.maximum(frame, rng.spawn("frame", index).integer(1, 9) * depth).astype(np.uint8)
    """
)


def write_rain(folder: Path) -> None:
    (folder / "rain_module.py").write_text(RAIN)
    (folder / "rain_depth.py").write_text("DEPTH = 4\n")


def forget() -> None:
    for name in ("rain_module", "rain_depth"):
        sys.modules.pop(name, None)
