"""Registry of benchmarks by name: look up facts without loading data, or open a benchmark on its data.

Any dataset is a benchmark: the user's own frames (`folder`), a registered dataset such as Sintel, a dataset or
benchmark of the user (`mypkg:MyBench`).
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from ...core.errors import DataError, UsageError, unknown_name
from ...core.paths import user_path
from ...core.plugins import Registry, called, import_target, is_target
from ...corruptions import IMAGE_PAIR
from ..datasets import DATASETS, PreCorrupted, dataset_facts
from ..datasets.dataset import OWN_FRAMES, facts_of
from ..datasets.own_dataset import check_members, open_own_dataset, own_source
from ..datasets.own_depth import OwnDepth
from ..datasets.registry import open_dataset
from ..datasets.split import read_split, selected
from .benchmark import Benchmark
from .facts import NON_OCCLUDED, BenchmarkFacts, facts_of_dataset, facts_of_still, is_still, moving_name, truth_remark


def own_benchmark(target: str, data: Path | None, split: Path | None) -> Benchmark:
    made = import_target(target, "benchmark")
    if not isinstance(made, Benchmark):
        opener = made if inspect.isroutine(made) else getattr(made, "open", None)
        if opener is None:
            raise UsageError(target, "not a benchmark: it has no function open; see the guide 'add your dataset'")
        if inspect.isclass(made) and not isinstance(inspect.getattr_static(made, "open"), staticmethod | classmethod):
            opener = called(target, "its constructor", made).open
        made = called(target, "open(data, split)", lambda: opener(data, split))
    if not isinstance(made, Benchmark):
        raise UsageError(target, f"returned {type(made).__name__}; open must return a Benchmark")
    _check_new(made.name, target)
    check_members(made.dataset, f"the dataset of {target}")
    check_keys(made, target)
    source = {"benchmark": target, "source": own_source(target, made.dataset)}
    return replace(made, protocol={**made.protocol, "own": source})


def _check_new(name: str, target: str) -> None:
    if name in (*BENCHMARKS.names(), *DATASETS.names()):
        raise UsageError(target, f"'{name}' is the name of a registered benchmark or dataset; choose a different name")


def check_keys(benchmark: Benchmark, what: str) -> None:
    if not benchmark.keys:
        raise UsageError(what, "lists no samples; keys must contain at least one key of its dataset")
    known = set(called(f"the dataset of {what}", "keys()", benchmark.dataset.keys))
    for key in benchmark.keys:
        if key not in known:
            raise UsageError(what, f"lists the sample {key!r:.60}, which its dataset does not contain")


def own_dataset_benchmark(target: str, split: Path | None, options: dict[str, Any]) -> Benchmark:
    dataset = open_own_dataset(target, options)
    _check_new(dataset.name, target)
    keys = read_split(split, dataset.keys()) if split else dataset.keys()
    protocol: dict[str, Any] = {"own": {"dataset": target, "source": own_source(target, dataset)}}
    if options:
        protocol["options"] = {key: str(value) for key, value in sorted(options.items())}
    facts = facts_of_dataset(facts_of(dataset, dataset.name))
    return Benchmark(dataset.name, dataset, tuple(keys), IMAGE_PAIR, protocol=protocol, facts=facts)


def from_dataset(
    name: str, data: Path | None, split: Path | None, options: dict[str, Any], still: bool = False
) -> Benchmark:
    """Return a benchmark with every sample of a dataset under every image-pair corruption, or those in its files. For
    still scenes, every frame of a user's own counts, so nothing is recognised or left out."""
    every_frame = {"pairs": "consecutive", "gaps": "keep"} if still and name == OWN_FRAMES else {}
    dataset, facts = open_dataset(name, data, **every_frame | options), dataset_facts(name)
    if isinstance(dataset, PreCorrupted) and not facts.corruptions:
        instead = f": use --benchmark {facts.benchmark}" if facts.benchmark else ""
        raise UsageError(name, f"its frames are corrupted already{instead}")
    keys = selected(split, dataset.keys(), name) if split else dataset.keys()
    deciding = {key: str(value) for key, value in sorted(options.items()) if key not in facts.folder_options}
    deciding |= getattr(dataset, "recognised", {})
    protocol: dict[str, Any] = {"options": deciding} if deciding else {}
    if getattr(dataset, "non_occluded", False):
        protocol |= NON_OCCLUDED
        warnings.warn(f"{data}: no flow_occ/, so errors are measured on {truth_remark(protocol)}", stacklevel=4)
    about = facts_of_dataset(facts)
    if not isinstance(dataset, PreCorrupted):
        return Benchmark(name, dataset, tuple(keys), IMAGE_PAIR, protocol=protocol, facts=about)
    there = tuple(corruption for corruption in facts.corruptions if dataset.has_corrupted(corruption))
    if not there:
        raise DataError(data, f"has clean frames of {facts.title} but no corrupted ones; expected {facts.layout}")
    protocol["frames"] = "released"
    return Benchmark(name, dataset, tuple(keys), there, about.severities, protocol=protocol, closed=True, facts=about)


class Definition(Protocol):
    """Definition of a registered benchmark: a class with its facts and a method to open it."""

    facts: BenchmarkFacts

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """Return the benchmark on the data in a folder."""


DEFAULT = "demo"
"""The default benchmark."""

BENCHMARKS: Registry[Definition] = Registry("benchmark", entry_point_group="robustflow.benchmarks")
for _name, _target in (("demo", "Demo"), ("kitti-fc", "KittiFC"), ("gopro-fc", "GoProFC")):
    BENCHMARKS.add(_name, f"robustflow.data.benchmarks.paper:{_target}")


def load_benchmark(
    name: str,
    data: str | Path | None = None,
    split: str | Path | None = None,
    options: dict[str, Any] | None = None,
    still: bool = False,
) -> Benchmark:
    """Open a benchmark by name; `still` if its frames will be paired with themselves."""
    others = dict(options or {})
    own = [others.pop(key, None) for key in ("depth", "focal", "depth_unit")]
    return with_own_depth(_load(name, data, split, others, still), *own)


def with_own_depth(
    benchmark: Benchmark, folder: str | Path | None, focal: float | None, unit: str | None = None
) -> Benchmark:
    if folder is not None:
        return replace(benchmark, own_depth=OwnDepth(folder, benchmark.dataset, focal, unit))
    for option, value in (("--focal", focal), ("--depth-unit", unit)):
        if value is not None:
            raise UsageError(option, "only applies to your own depth maps; give --depth DIR as well, or leave it out")
    return benchmark


def _load(
    name: str, data: str | Path | None, split: str | Path | None, options: dict[str, Any], still: bool
) -> Benchmark:
    chosen = user_path(split) if split is not None else None
    if data is not None and is_target(str(data)) and not Path(data).exists():
        if name != DEFAULT:
            raise UsageError("--benchmark", f"{data} is a custom dataset; omit it, or give the folder of {name}")
        return own_dataset_benchmark(str(data), chosen, options)
    root = user_path(data) if data is not None else None
    if name == DEFAULT and root is not None:
        name = _benchmark_of(root)
    if options and (is_target(name) or name in BENCHMARKS.names()):
        raise UsageError(name, f"the benchmark has no data options; omit {', '.join(options)}")
    if is_target(name):
        return own_benchmark(name, root, chosen)
    try:
        if name in BENCHMARKS.names():
            return BENCHMARKS.get(name).open(root, chosen)
        if name in DATASETS:
            return from_dataset(name, root, chosen, options, still)
        if Path(name).exists():
            raise UsageError(name, f"a path, not a benchmark; give --benchmark folder, --data {name}")
        raise unknown_name("benchmark", name, (*BENCHMARKS.names(), *DATASETS.names()))
    except DataError as error:
        fitting = _fitting(root) if root is not None else None
        if fitting is None or name in (fitting, *_ALSO_READ_BY.get(fitting, ())):
            raise
        raise DataError(error.culprit, f"{error.args[-1]}; it looks like the data of --benchmark {fitting}") from error


_MARKS = {
    "kitti2012": ("training/colored_0", "colored_0", "training/image_0", "image_0"),
    "kitti-fc": ("training/image_2", "image_2", "clean/val/image_2"),
    "sintel": ("training/clean", "training/final"),
    "hd1k": ("hd1k_input/image_2",),
    "spring": ("train/0001/frame_left",),
    "middlebury": ("other-gt-flow",),
    "flyingthings3d": ("frames_cleanpass", "frames_finalpass", "train/image_clean"),
    "gopro-fc": ("gopro_fc.json",),
}
"""For each benchmark, paths that exist only in its folder."""

_ALSO_READ_BY = {"kitti-fc": ("kitti2015", "kitti_multiview", "kitti_fc_released"), "gopro-fc": ("gopro_fc_prepared",)}
"""Datasets that read the folder of a benchmark, too."""


def _fitting(root: Path) -> str | None:
    """Return the benchmark whose layout matches a folder."""
    fitting = (name for name, marks in _MARKS.items() if any((root / mark).exists() for mark in marks))
    return next(fitting, None)


def _benchmark_of(root: Path) -> str:
    """Choose the benchmark for data given without a benchmark: "folder", unless the data look like a known dataset."""
    if not root.exists():
        raise DataError(root, "no such file or folder; check the path")
    if fitting := _fitting(root):
        raise UsageError("--benchmark", f"{root} looks like the data of {fitting}; give --benchmark {fitting}")
    return "folder"


def outside_remark(name: str, protocol: Mapping[str, Any], keys: Collection[str]) -> str:
    """Say how many of the pairs that were measured are not of the benchmark, for example of a user's split; "" if all
    are. The authors' files contain only its pairs."""
    members = getattr(BENCHMARKS.get(name), "members", None) if name in BENCHMARKS else None
    outside = 0 if members is None or protocol.get("frames") == "released" else len(keys) - len(members(keys))
    return f"{outside} of {len(keys)} not of {benchmark_facts(name).title}" if outside else ""


def benchmark_facts(name: str) -> BenchmarkFacts:
    """Return the facts of a benchmark by its name, for code that reads manifests and tables without the data."""
    if is_still(name):
        return facts_of_still(benchmark_facts(moving_name(name)))
    if name in BENCHMARKS.names():
        facts = getattr(BENCHMARKS.get(name), "facts", None)
        if isinstance(facts, BenchmarkFacts):
            return facts
    elif name in DATASETS:
        return facts_of_dataset(dataset_facts(name))
    return BenchmarkFacts(title=name[:80] or "unnamed")
