"""The set-up of one run: benchmark, model and options, from a request or from what a finished run recorded."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..benchmarks import BENCHMARKS, Benchmark, load_benchmark
from ..benchmarks.setting import training_record
from ..corruptions import load_corruption
from ..corruptions.base import Corruption
from ..corruptions.on_disk import on_disk
from ..corruptions.own import is_known, own_among
from ..corruptions.scale import calibration_digest
from ..corruptions.sources import OWN_KEY, recorded_sources, user_sources
from ..datasets import DATASETS
from ..datasets.base import Dataset, FromClips
from ..datasets.context_frames import window_on
from ..errors import RobustFlowError, RunError, UsageError
from ..models import ModelSpec
from ..models.base import AnyModel
from ..models.provenance import training_of
from ..models.window import Window
from ..runs.identity import checked_name, differing
from ..runs.plan import Plan, RunOptions, left_out_sentence
from ..runs.run import Run
from ..runs.source import RunSource
from ..text import plain
from .named_model import NamedModel, name_model


@dataclass(frozen=True)
class Setup:
    """A plan and the model that carries it out."""

    plan: Plan
    model: NamedModel

    @property
    def dataset(self) -> Dataset:
        """The data set of the plan's benchmark."""
        return self.plan.benchmark.dataset

    @property
    def options(self) -> RunOptions:
        """The plan's options."""
        return self.plan.options


def set_up(
    model: str | Path | ModelSpec | AnyModel | Callable[..., Any],
    benchmark: Benchmark,
    *,
    seed: int = 0,
    variant: str = "default",
    severity_scale: str = "paper",
    allow_invalid: bool = False,
    common_draws: bool = False,
    name: str | None = None,
) -> Setup:
    """Set up a run from a request: it is checked as a whole and the model is loaded, but nothing is computed.

    Args:
        model: see `robustflow.evaluate`.
        benchmark: from `open_benchmark`, restricted to what should run.
        seed, variant, severity_scale, allow_invalid, common_draws, name: see `robustflow.evaluate`.

    Raises:
        UsageError: parts that do not fit together, or nothing to run.
        ModelError: the model cannot be loaded.
    """
    for corruption in benchmark.corruptions:
        if not benchmark.closed or on_disk(corruption) is None:
            load_corruption(corruption, variant, severity_scale)
    if benchmark.closed and severity_scale != "paper":
        raise UsageError(
            "these frames were corrupted beforehand, at the paper's severities; leave out --severity-scale, "
            "or give the uncorrupted data"
        )
    named = name_model(model)
    window = window_on(named.model, benchmark.dataset)
    options = _options(
        seed, variant, severity_scale, allow_invalid, window, benchmark.corruptions, common_draws, benchmark.classes
    )
    training = training_of(named.identity, named.declared)
    shown = checked_name(name) if name is not None else named.name and checked_name(named.name)
    provenance = training_record(training, benchmark.name, benchmark.keys, benchmark.protocol)
    plan = Plan(benchmark, options, named.identity, provenance, shown)
    if plan.left_out() and len(plan.units()) == len(benchmark.keys):
        raise UsageError(
            f"nothing to run: {left_out_sentence(plan.left_out())}; choose others, or the paper's --severity-scale"
        )
    return Setup(plan, named)


def restore_setup(run: Run, source: RunSource) -> Setup:
    """Set up a finished run again from its manifest, with the model and the data that `source` names.

    Raises:
        RunError: the model cannot be loaded any more, or what is set up now is not what was run.
        UsageError, DataError: the data set is missing.
    """
    identity = run.manifest["identity"]
    _check_registered(identity["benchmark"])
    benchmark = open_benchmark(identity["benchmark"], source.data, None, source.data_options, identity["variant"])
    if source.model is None:
        raise RunError(f"{run.path} was run with a Python object, which has no name; give --model NAME")
    try:
        named = name_model(source.model)
    except RobustFlowError as error:
        raise RunError(f"the model of {run.path} can no longer be loaded: {error}") from error
    options = _options_of(identity, benchmark.classes, window_on(named.model, benchmark.dataset))
    plan = Plan(benchmark, options, named.identity)
    if plan.digest() != run.manifest["identity_digest"]:
        raise RunError(
            f"what is set up now is not what {run.path} ran (it differs in: {differing(plan.identity(), identity)}); "
            "give the options that the run was given"
        )
    return Setup(plan, named)


def set_up_frames(
    identity: dict[str, Any], data: str | Path | None, data_options: dict[str, Any]
) -> tuple[Dataset, RunOptions]:
    """Data set and options with which the frames of a run can be recomputed, without its model.

    Raises:
        RunError: these are not the data, severities or files that the run was made with.
        UsageError, DataError: the data set is missing.
    """
    _check_registered(identity["benchmark"])
    benchmark = open_benchmark(identity["benchmark"], data, None, data_options, identity["variant"])
    protocol = json.loads(json.dumps(benchmark.protocol, default=str))  # in the form in which a manifest is read
    if DATASETS.recorded_name(benchmark.dataset.name) != identity["dataset"] or protocol != identity["protocol"]:
        raise RunError(
            f"the run's data are {identity['dataset']} {identity['protocol']}, these are {benchmark.dataset.name} "
            f"{protocol}; give the data and data options of the run"
        )
    # Invalid pixels come from a model, which is not used here.
    options = _options_of({**identity, "allow_invalid": True}, benchmark.classes)
    if "severity_scale" in identity and identity["severity_scale"] != f"calibrated {calibration_digest()}":
        raise RunError("the run's calibrated severities are not those of this version; use the version that ran it")
    if dict(options.sources) != (recorded := recorded_sources(identity)):
        raise RunError(
            "the run's corruptions read other files than those set up here "
            f"({differing(dict(options.sources), recorded)}); set ROBUSTFLOW_PSF_DIR as the run did"
        )
    return benchmark.dataset, options


def _check_registered(benchmark: Any) -> None:
    """Raise if only code named by a stranger's file could open a benchmark."""
    if benchmark not in BENCHMARKS and benchmark not in DATASETS:
        raise RunError(
            f"unknown benchmark '{plain(str(benchmark))}' of the run: neither this package nor an installed one offers "
            "it, and no code is loaded because a run names it"
        )


def open_benchmark(
    benchmark: str | Benchmark,
    data: str | Path | None = None,
    split: str | Path | None = None,
    options: dict[str, Any] | None = None,
    variant: str = "default",
) -> Benchmark:
    """A benchmark, by name or as an object, its clips under a variant of the corruptions.

    Raises:
        UsageError, DataError: see `load_benchmark`.
    """
    chosen = load_benchmark(benchmark, data, split, options) if isinstance(benchmark, str) else benchmark
    if isinstance(chosen.dataset, FromClips):
        chosen = replace(chosen, dataset=chosen.dataset.with_variant(variant))
    return chosen


def _options_of(
    identity: dict[str, Any], classes: Mapping[str, type[Corruption]], window: Window | None = None
) -> RunOptions:
    scale = "calibrated" if str(identity.get("severity_scale", "")).startswith("calibrated") else "paper"
    own = [str(name) for name in identity.get(OWN_KEY, {})]
    for name in own:
        if not is_known(name):
            raise RunError(
                f"the run's corruption '{plain(name)}' is your own or an installed package's, and unknown here: name "
                "it with --own-corruption MODULE:ATTRIBUTE, or install its package"
            )
    common_draws = bool(identity.get("common_draws", False))
    return _options(
        identity["seed"],
        identity["variant"],
        scale,
        identity["allow_invalid"],
        window,
        own,
        common_draws,
        classes,
    )


def _options(
    seed: int,
    variant: str,
    scale: str,
    allow_invalid: bool,
    window: Window | None,
    corruptions: Sequence[str],
    common_draws: bool,
    classes: Mapping[str, type[Corruption]],
) -> RunOptions:
    sources = user_sources(variant, corruptions)
    return RunOptions(
        seed, variant, allow_invalid, scale, sources, window, common_draws, own_among(corruptions), classes
    )
