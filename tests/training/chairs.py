"""A folder in FlyingChairs' layout with pairs of moving textures."""

from pathlib import Path

import cv2
import numpy as np

from robustflow.media.flow import write_flow
from robustflow.testing import TexturePairs


def write_chairs(root: Path, count: int, size: tuple[int, int]) -> Path:
    """Write pairs of this size into `root`, all in the training split; return `root`."""
    folder = root / "FlyingChairs_release"
    data = folder / "data"
    data.mkdir(parents=True)
    pairs = TexturePairs(count=count, size=size, reach=5, seed=9)
    for number, key in enumerate(pairs.keys(), 1):
        sample = pairs.load(key)
        for which, frame in enumerate(sample.frames, 1):
            cv2.imwrite(str(data / f"{number:05d}_img{which}.ppm"), np.ascontiguousarray(frame[..., ::-1]))
        assert sample.flow is not None
        write_flow(data / f"{number:05d}_flow.flo", sample.flow)
    (folder / "FlyingChairs_train_val.txt").write_text("1\n" * count)
    return root
