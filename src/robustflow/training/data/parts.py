"""Find the datasets of a mix in the user's folders, and define the order of their pairs, which depends only on the seed
and the position.

Positions count the pairs of a training run from 0: place i in the batch of n pairs at step t has the position t * n +
i. The pair at a position does not depend on the number of loader workers or processes, or on when a training run was
resumed.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...core.errors import DataError, UsageError
from ...core.paths import user_path
from ...core.rng import Rng
from ...data.datasets import DATASETS, needs_folder
from ...data.datasets.dataset import Dataset
from ...data.datasets.own_frames import continuous
from ...data.datasets.registry import open_dataset
from ...data.datasets.split import kitti_split
from ..recipe import Part, Recipe, mix_parts


class Order:
    """Shuffle the pairs of each epoch; an incomplete last update of an epoch is dropped, as in a loader with
    `drop_last`.
    """

    def __init__(self, count: int, block: int, seed: int) -> None:
        if count < block:
            raise UsageError(
                "--batch-size", f"{count} pairs are too few for one update ({block}); use more data, or smaller batches"
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


_FOLDERS = {
    "flyingchairs": ("flyingchairs", "flyingchairsrelease", "chairs"),
    "flyingthings3d": ("flyingthings3d", "flyingthings3dsubset", "flyingthings", "things"),
    "sintel": ("sintel", "mpisintel", "mpisintelcomplete"),
    "hd1k": ("hd1k", "hd1kfullpackage"),
    "kitti2015": ("kitti2015", "kitti", "kittisceneflow", "datasceneflow"),
    "kitti2012": ("kitti2012", "datastereoflow"),
    "kitti_multiview": ("kittimultiview", "datasceneflowmultiview", "kitti2015", "kitti"),
    "kitti_raw": ("kittiraw", "rawdata"),
    "folder": ("frames", "sintelraw"),
}
"""Folder names of datasets, in lower-case letters and digits; all other datasets are searched for under their own
names."""


@dataclass(frozen=True)
class OpenPart:
    """A part of a mix, with its dataset."""

    part: Part
    dataset: Dataset
    keys: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of pairs in an epoch."""
        return len(self.keys) * self.part.times


def needs_data(recipe: Recipe) -> bool:
    """Return whether any part of a recipe's mix is read from a user's folder.

    >>> from robustflow.training.recipe import load_recipe
    >>> needs_data(load_recipe("raft", "ood")), needs_data(load_recipe("tiny", "shapes"))
    (True, False)
    """
    return any(needs_folder(part.data) for part in mix_parts(recipe.mix))


def open_part(part: Part, data: Sequence[str | Path], labelled: bool) -> OpenPart:
    """Find and open a part's dataset."""
    named, roots = _named_paths_and_roots(data)
    folder = named.get(part.data)
    if folder is None and needs_folder(part.data):
        dataset = _search(part, roots)
    else:
        dataset = open_dataset(part.data, folder, **part.options)
    if labelled and not dataset.has_flow:
        raise UsageError(
            part.data, "has no ground truth to train on; choose a different mix, or a recipe without labels"
        )
    keys = continuous(dataset, dataset.keys(), compare=False)
    if part.keys == "training":
        keys = kitti_split(keys).training
        if not keys:
            raise DataError(
                part.data,
                "with fewer than 200 pairs, all of them are used for evaluation and none for training; "
                "use the complete dataset, or use the recipe 'kitti', which trains on every pair",
            )
    if getattr(dataset, "non_occluded", False):
        warnings.warn(
            f"{part.data} has no flow_occ/, so training uses its non-occluded ground truth (flow_noc/): the network "
            "does not learn occluded motion, and the data differ from the recipe's; unpack flow_occ/",
            stacklevel=2,
        )
    return OpenPart(part, dataset, tuple(keys))


def _named_paths_and_roots(data: Sequence[str | Path]) -> tuple[dict[str, Path], list[Path]]:
    named: dict[str, Path] = {}
    roots: list[Path] = []
    for entry in data:
        name, equals, folder = str(entry).partition("=")
        if equals and re.fullmatch(r"[a-z0-9_]+", name):
            if name not in DATASETS:
                raise UsageError("--data", f"{entry}: unknown dataset '{name}'; see 'robustflow list datasets'")
            named[name] = user_path(folder)
        else:
            roots.append(user_path(entry))
    return named, roots


def _search(part: Part, roots: list[Path]) -> Dataset:
    names = _FOLDERS.get(part.data, (_plain(part.data),))
    reasons = []
    for root in roots:
        if not root.is_dir():
            reasons.append(f"{root}: no such folder")
            continue
        candidates = [child for child in sorted(root.iterdir()) if child.is_dir() and _plain(child.name) in names]
        anything = part.data == "folder"  # any folder of images would match, so do not use the first one
        for folder in candidates if anything else [*candidates, root]:
            try:
                return open_dataset(part.data, folder, **part.options)
            except DataError as error:
                if folder in candidates or _plain(folder.name) in names:
                    reasons.append(str(error))
    options = " ".join(f"{key}={value}" for key, value in part.options.items())
    where = ", ".join(map(str, roots)) or "--data was not given"
    raise DataError(
        f"{part.data} {options}".strip(),
        f"not found ({'; '.join(reasons) or where}); put it into a folder named {' or '.join(names[:2])} in a data "
        f"folder, or pass --data {part.data}=FOLDER",
    )


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
