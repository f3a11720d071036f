"""The demo pair at a third of its width and height, for tests whose claim does not depend on its size."""

from pathlib import Path

import numpy as np
import skimage
from PIL import Image


def write_small_demo(folder: Path) -> str:
    """Write the files, and return the value of `skimage.__file__` that makes the package find them."""
    whole = Path(skimage.__file__).parent / "data"
    (folder / "data").mkdir()
    for name in ("motorcycle_left.png", "motorcycle_right.png"):
        with Image.open(whole / name) as frame:
            frame.reduce(3).save(folder / "data" / name)
    with np.load(whole / "motorcycle_disp.npz") as disparity:
        np.savez(folder / "data" / "motorcycle_disp.npz", disparity["arr_0"][::3, ::3] / 3)
    return str(folder / "__init__.py")
