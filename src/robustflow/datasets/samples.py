"""A dataset as a Python sequence: `len`, `ds[0]`, `ds["key"]`, `for sample in ds`, and a `repr`."""

from __future__ import annotations

from collections.abc import Iterator
from operator import index as whole_number
from typing import TYPE_CHECKING

from ..sample import Sample
from ..text import counted

if TYPE_CHECKING:
    from .base import Dataset


class Samples:
    """Mixin that makes a `Dataset` usable as a sequence, through its `keys` and `load`. Samples are read on access.

    >>> from robustflow.datasets import load_dataset
    >>> pairs = load_dataset("motorcycle")
    >>> pairs, len(pairs), pairs[0].key, pairs["motorcycle"].shape, [sample.key for sample in pairs]
    (<Motorcycle: 1 pair, with ground truth>, 1, 'motorcycle', (500, 741), ['motorcycle'])
    """

    def __len__(self: Dataset) -> int:
        return len(self.keys())

    def __iter__(self: Dataset) -> Iterator[Sample]:
        return (self.load(key) for key in self.keys())

    def __getitem__(self: Dataset, place: int | str) -> Sample:
        """Return one sample by its key or by its position; negative positions count from the end."""
        if isinstance(place, str):
            return self.load(place)
        return self.load(self.keys()[whole_number(place)])

    def __repr__(self: Dataset) -> str:
        truth = "with ground truth" if self.has_flow else "no ground truth"
        return f"<{type(self).__name__}: {counted(len(self.keys()), 'pair')}, {truth}>"
