"""Check a user-defined dataset before using it in a benchmark, and provide a small dataset with known flow."""

from __future__ import annotations

import pickle
from copy import deepcopy
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..core.errors import RobustFlowError, UsageError
from ..core.types import Sample
from ..data.datasets.dataset import DatasetFacts
from ..data.datasets.own_dataset import check_members, check_sample
from ..data.datasets.pair_files import Samples
from ..metrics.photometric import misread_truth
from .extensions import require


class TexturePairs(Samples):
    """A dataset without files. Each pair shows a different smooth texture that moves by an integer shift, so the flow
    is exact.

    Args:
        count: number of pairs; their keys are "0", "1", ...
        size: size (H, W) of the frames, in pixels.
        reach: maximum shift along either axis, in pixels.
        seed: the seed for the textures and shifts.

    Raises:
        UsageError: the count is below 1, or the frames are not larger than the shift.

    >>> pairs = TexturePairs(count=2, size=(32, 48))
    >>> pairs.keys()
    ['0', '1']
    >>> sample = pairs.load("1")
    >>> u, v = sample.flow[0, 0].astype(int).tolist()
    >>> bool((sample.frames[0][8:24, 8:40] == sample.frames[1][8 + v : 24 + v, 8 + u : 40 + u]).all())
    True
    """

    name = "texture_pairs"
    """Name of the dataset in results."""
    has_flow = True
    """True: every pair has ground truth."""
    facts = DatasetFacts(title="Moving textures", description="Textures with integer shifts, for tests.")
    """Description of the dataset for readers of results."""

    def __init__(self, count: int = 3, size: tuple[int, int] = (64, 96), reach: int = 4, seed: int = 0) -> None:
        if count < 1 or not 0 <= reach < min(size):
            raise UsageError("size", f"cannot create {count} pairs of {size} pixels with shifts of up to {reach}")
        self._count, self._size, self._reach, self._seed = int(count), size, int(reach), int(seed)

    def keys(self) -> list[str]:
        """See `Dataset.keys`."""
        return [str(number) for number in range(self._count)]

    def files(self, key: str) -> list[Path]:
        """See `Dataset.files`; always empty."""
        return []

    def load(self, key: str) -> Sample:
        """See `Dataset.load`: the flow is float32 (H, W, 2) in pixels and known everywhere; pixels that leave the frame
        are marked as occluded.

        Raises:
            KeyError: the key does not exist.
        """
        if key not in self.keys():
            raise KeyError(f"there is no pair '{key}': the keys are 0 to {self._count - 1}")
        rng = np.random.default_rng([self._seed, int(key)])
        (height, width), reach = self._size, self._reach
        u, v = (int(shift) for shift in rng.integers(-reach, reach + 1, 2))
        whole = (height + 2 * reach, width + 2 * reach)
        coarse = rng.integers(0, 256, (whole[0] // 4 + 2, whole[1] // 4 + 2, 3), np.uint8)
        texture = cv2.resize(coarse, whole[::-1], interpolation=cv2.INTER_LINEAR)
        corners = ((reach, reach), (reach - v, reach - u))
        frames = tuple(np.ascontiguousarray(texture[y : y + height, x : x + width]) for y, x in corners)
        rows, columns = np.mgrid[:height, :width] + np.array([v, u])[:, None, None]
        outside = (rows < 0) | (rows >= height) | (columns < 0) | (columns >= width)
        flow = np.empty((height, width, 2), np.float32)
        flow[:] = (u, v)
        return Sample(key, frames, flow, np.ones((height, width), bool), outside)


def check_dataset(dataset: Any, samples: int = 3) -> str:
    """Check a dataset, and return its name.

    A dataset must have a name, return the same keys on every call, and return samples as declared: RGB uint8 frames of
    equal size, and float32 flow with a valid mask if `has_flow`. Frame 2 warped by the flow must not explain frame 1
    clearly worse than with swapped, negated or rescaled components or rows in reverse order. A sample must have the
    same bytes when it is read twice or in a different process, and keep them when the next one is read. All listed
    files must exist, and an unknown key must raise an error.

    Args:
        dataset: an object that implements `robustflow.data.datasets.Dataset`; see docs/add-your-dataset.md.
        samples: number of samples to read, evenly spaced over the keys.

    Raises:
        UsageError: a check failed; the message states the problem.

    >>> from robustflow.data.datasets import load_dataset
    >>> check_dataset(load_dataset("motorcycle"))
    'motorcycle'
    """
    what = f"the dataset {type(dataset).__name__}"
    check_members(dataset, what)
    keys, name = dataset.keys(), str(dataset.name)
    require(dataset.keys() == keys, name, "keys() returns different keys on the second call")
    try:
        copy = pickle.loads(pickle.dumps(dataset))
    except Exception as error:
        raise UsageError(name, f"cannot be sent to a worker process ({type(error).__name__}: {error})") from error
    require(copy.keys() == keys, name, "a pickled copy has different keys")
    places = np.linspace(0, len(keys) - 1, max(1, min(samples, len(keys)))).astype(int)
    before: tuple[Sample, Sample] | None = None
    for key in dict.fromkeys(keys[place] for place in places):
        first, again = check_sample(dataset, key, what), check_sample(copy, key, what)
        require(_equal(first, again), name, f"sample '{key}' differs when read a second time")
        finite = first.flow is None or (first.flow.dtype == np.float32 and np.isfinite(first.flow).all())
        require(finite, name, f"the flow of '{key}' must be float32 and finite; mark unknown pixels in the valid mask")
        if before is not None:
            require(_equal(*before), name, f"load('{key}') overwrites the sample loaded before; return new arrays")
        before = first, deepcopy(first)
        require(first.valid is None or first.valid.any(), name, f"sample '{key}' has no pixel with known flow")
        if (wrong := misread_truth(first)) is not None:
            raise UsageError(
                name,
                f"the ground truth of '{key}' looks {wrong.reading.describe()}: {wrong.describe()}; return (u right, v "
                "down) in pixels from frame 1 to frame 2",
            )
    try:
        dataset.load("no such key")
    except (RobustFlowError, LookupError):
        return name
    except Exception as error:
        raise UsageError(name, f"raises {type(error).__name__} for an unknown key; raise a KeyError") from error
    raise UsageError(name, "returns a sample for a key that does not exist; raise a KeyError")


def _equal(first: Sample, other: Sample) -> bool:
    pairs = [*zip(first.frames, other.frames, strict=False), (first.flow, other.flow), (first.valid, other.valid)]
    same = all((a is None and b is None) or np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)
    return same and len(first.frames) == len(other.frames) and first.group == other.group
