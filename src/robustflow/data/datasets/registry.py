"""Registry of datasets by name, imported on first use; `load_dataset` opens one."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ...core.errors import UsageError, unknown_name
from ...core.paths import user_path
from ...core.plugins import Registry
from .dataset import OWN_FRAMES, Dataset, DatasetFacts, facts_of

DATASETS: Registry[Callable[..., Dataset]] = Registry("dataset", entry_point_group="robustflow.datasets")
"""Registered datasets: callables that take the root (if required) and keyword options, and return a `Dataset`."""

_TARGETS = {
    "motorcycle": "motorcycle:Motorcycle",
    "kitti2015": "kitti:Kitti2015",
    "kitti2012": "kitti:Kitti2012",
    "kitti_multiview": "kitti_sequences:KittiMultiview",
    "kitti_raw": "kitti_sequences:KittiRaw",
    "middlebury": "middlebury:Middlebury",
    "sintel": "sintel:Sintel",
    "hd1k": "hd1k:HD1K",
    "spring": "spring:Spring",
    "robustspring": "robustspring:RobustSpring",
    "flyingchairs": "flyingchairs:FlyingChairs",
    "flyingthings3d": "flyingthings3d:FlyingThings3D",
    "tartanair": "tartanair:TartanAir",
    "gopro": "gopro:GoPro",
    "folder": "folder:open_folder",
    "shapes": "shapes.dataset:FlyingShapes",
    "kitti_fc_released": "released:KittiFCReleased",
    "gopro_fc_prepared": "gopro_fc:GoProFCPrepared",
    "gopro_fc_released": "released:GoProFCReleased",
}
for _name, _target in _TARGETS.items():
    DATASETS.add(_name, f"robustflow.data.datasets.{_target}")


def load_dataset(name: str, root: str | Path | None = None, **options: Any) -> Dataset:
    """Open a dataset. In a user's own frames, all pairs are compared, and left out if they are not consecutive frames
    (`own_frames`).

    Args:
        name: name in `DATASETS`.
        root: path of the dataset's folder; None for a dataset without a folder.
        options: keyword options of the dataset (`step=2`, `render_pass="final"`).

    Raises:
        UsageError: a name or option is unknown, or a root is missing or not supported.
        DataError: files are missing or invalid.

    >>> load_dataset("motorcycle").keys()
    ['motorcycle']
    >>> load_dataset("motorcycel")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    robustflow.core.errors.UsageError: unknown dataset 'motorcycel': did you mean 'motorcycle'? Known: ...
    """
    dataset = open_dataset(name, root, **options)
    if name == OWN_FRAMES:
        from .own_frames import OwnFrames, continuous

        if isinstance(dataset, OwnFrames):
            dataset.keep(continuous(dataset, dataset.keys()))
    return dataset


def open_dataset(name: str, root: str | Path | None = None, **options: Any) -> Dataset:
    """Open a dataset as `load_dataset` does, without comparing frames."""
    if name not in DATASETS and Path(name).exists():
        raise UsageError(name, f"a path, not the name of a dataset; give the name first: 'folder', {name!r}")
    factory = DATASETS.get(name)
    parameters = inspect.signature(factory).parameters
    takes_root = needs_folder(name)
    if takes_root and root is None:
        raise UsageError("--data", f"dataset '{name}' is read from a folder; give it (load_dataset calls it root)")
    if root is not None and not takes_root:
        raise UsageError("--data", f"dataset '{name}' needs no folder; omit it (load_dataset calls it root)")
    for option in options:
        if option == "root" or option not in parameters:
            raise unknown_name(f"option of dataset '{name}'", option, [p for p in parameters if p != "root"])
    return factory(root, **options) if takes_root else factory(**options)


def needs_folder(name: str) -> bool:
    """Return whether a dataset is read from a user's folder."""
    return "root" in inspect.signature(DATASETS.get(name)).parameters


def with_absolute_paths(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Make folder paths among the options of a dataset absolute, including the folder of the user's depth maps."""
    folders = ("depth", *dataset_facts(name).folder_options)
    return {key: user_path(value).absolute() if key in folders else value for key, value in options.items()}


def dataset_facts(name: str) -> DatasetFacts:
    return facts_of(DATASETS.get(name) if name in DATASETS else None, name)
