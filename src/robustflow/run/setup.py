"""Set up one run: benchmark, model and options, from a request or from the manifest of a finished run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.arguments import check_count
from ..core.errors import RobustFlowError, RunError, UsageError
from ..core.text import plain
from ..corruptions.corruption import BGR, VARIANTS
from ..corruptions.user_corruptions import is_known
from ..data.benchmarks import BENCHMARKS, Benchmark, benchmark_facts, load_benchmark
from ..data.benchmarks.facts import check_still, is_still, moving_name
from ..data.benchmarks.registry import check_keys
from ..data.datasets import DATASETS
from ..data.datasets.dataset import FromClips
from ..models import MODELS, ModelRef
from ..models.confidence import check_confidence
from ..models.protocols import AnyModel, BatchedFlowModel, ClipModel, FlowLookup
from .cells import left_out_sentence
from .config import DEFAULTS, MeasuringOptions, RunConfig
from .identity import FrameIdentity, Identity, checked_name, difference, differing_fields
from .plan import NO_MODEL, NamedModel, Plan, load_corruptions, name_model
from .run import Run
from .source import RunSource


def set_up(
    model: str | Path | ModelRef | NamedModel | AnyModel | Callable[..., Any],
    benchmark: Benchmark,
    config: RunConfig = DEFAULTS,
) -> Plan:
    """Check a request and load its model, without computing anything."""
    frames, measuring = config.frames, config.measuring
    corruptions = load_corruptions(benchmark, frames)  # fails before the model is loaded, which may take long
    if benchmark.closed and frames.severity_scale != "paper":
        raise UsageError("--severity-scale", "these frames were corrupted beforehand; omit it")
    named = model if isinstance(model, NamedModel) else name_model(model)
    if is_still(benchmark.name) and isinstance(named.model, FlowLookup):
        raise UsageError("--still", "flow files cannot be used with it; choose a model that predicts")
    check_confidence(measuring.confidence, named.model)
    if measuring.draws > 1 and benchmark.closed:
        raise UsageError("--seeds", "these frames were corrupted beforehand, with one draw; omit it")
    if measuring.draws > 1 and measuring.confidence is not None:
        raise UsageError("--confidence", "a run measures either it or the spread over --seeds; omit one of the two")
    _check_batch_size(config.compute.batch_size, named.model)
    name = named.name if config.output.name is None else config.output.name
    plan = Plan(benchmark, named, config, corruptions, name=name if name is None else checked_name(name))
    if benchmark.attacks:
        from .attack_stage import with_attacks

        plan = with_attacks(plan)
    elif frames.variant not in (*VARIANTS, BGR):
        raise UsageError(frames.variant, f"unknown variant; choose from {', '.join((*VARIANTS, BGR))}")
    window = plan.window
    if benchmark.depth_to_read() is not None and window is not None:
        needed = window.before + 2 + window.after
        raise UsageError("--model", f"it needs {needed} frames, but 3D corruptions have the depth of only two")
    if plan.left_out() and len(plan.units()) == len(benchmark.keys):
        raise UsageError("--severity-scale", f"nothing to run: {left_out_sentence(plan.left_out())}")
    return plan


def _check_batch_size(size: int, model: AnyModel) -> None:
    check_count("--batch-size", size)
    if size > 1 and isinstance(model, ClipModel):
        raise UsageError("--batch-size", "a multi-frame model predicts one clip at a time; omit it")
    if size > 1 and not isinstance(model, BatchedFlowModel):
        raise UsageError("--batch-size", "the model has no method predict_batch; omit it")


def restore_plan(run: Run, source: RunSource) -> Plan:
    """Return the plan of a finished run from its manifest, with the model and the data named in `source`."""
    identity = run.manifest.identity
    if source.model is None:
        raise RunError(run.path, "run with a Python object, which has no name; specify --model NAME")
    try:
        named = name_model(source.model)
    except RobustFlowError as error:
        raise RunError(run.path, f"its model can no longer be loaded: {error}") from error
    check_confidence(identity.measuring.confidence, named.model)
    plan = recorded_plan(identity, run.manifest.corruptions, source.data, source.data_options, named)
    if plan.identity != identity:
        differing = difference(plan.identity, identity)
        raise RunError(run.path, f"the setup differs from the run's in: {differing}; use its options")
    return plan


def recorded_plan(
    identity: Identity,
    corruptions: Iterable[str],
    data: str | Path | None,
    data_options: dict[str, Any],
    model: NamedModel = NO_MODEL,
) -> Plan:
    """Return the plan of some of a run's corruptions from its identity, without its attacks, which are not repeated.
    The frames have to be the same, but the model may be different, or absent."""
    recorded = identity.frames
    benchmark = _benchmark_of(recorded, data, data_options)
    if unknown := [name for name in recorded.corruptions if not is_known(name)]:
        why = "unknown corruption of the run: give it with --own-corruption, or install its package"
        raise RunError(plain(unknown[0]), why)
    # invalid pixels depend on the model, which may be absent
    measuring = MeasuringOptions(allow_invalid=True) if model is NO_MODEL else identity.measuring.options
    config = RunConfig(frames=recorded.options, measuring=measuring)
    plan = Plan(benchmark, model, config, attack_sources=recorded.attack_sources).of_corruptions(
        dict.fromkeys((*corruptions, *recorded.corruptions))
    )
    if differing := differing_fields(made := plan.identity.frames, recorded):
        parts = [f"{getattr(recorded, name)}, here {getattr(made, name)}" for name in differing]
        remedies = [words for name, words in _REMEDIES.items() if name in differing]
        raise RunError(
            ", ".join(differing),
            f"the frames computed here differ from those of the run ({plain('; '.join(parts), 300)}); "
            f"{remedies[0] if remedies else 'use the version of the run'}",
        )
    return plan


_REMEDIES = {
    "dataset": "use the data and data options of the run",
    "protocol": "use the data and data options of the run",
    "depth": "pass the depth maps of the run with -D depth=DIR and, if it had them, -D focal=PX and -D depth_unit=UNIT",
    "psf": "set ROBUSTFLOW_PSF_DIR to the same value as for the run",
    "corruptions": "pass the run's version of your corruption with --own-corruption",
}


def _benchmark_of(frames: FrameIdentity, data: str | Path | None, data_options: dict[str, Any]) -> Benchmark:
    """Return the benchmark of a run; raise if opening it would load code named in an untrusted file."""
    name = moving_name(frames.benchmark)
    if name not in BENCHMARKS and name not in DATASETS:
        raise RunError(plain(frames.benchmark), "unknown benchmark; code named in a run is never loaded")
    return open_benchmark(name, data, None, data_options, frames.variant, still=is_still(frames.benchmark))


def open_benchmark(
    benchmark: str | Path | Benchmark,
    data: str | Path | None = None,
    split: str | Path | None = None,
    options: dict[str, Any] | None = None,
    variant: str = "default",
    still: bool = False,
) -> Benchmark:
    """Open a benchmark by name, or check a given one; clips in a variant, or without motion (`Benchmark.still`)."""
    if still and isinstance(benchmark, str):
        check_still(benchmark, benchmark_facts(benchmark))  # check this before a video is prepared, which takes minutes
    if isinstance(benchmark, Path):
        benchmark = str(benchmark)
    if isinstance(benchmark, str):
        if benchmark in MODELS:
            raise UsageError(benchmark, "the name of a model, not of a benchmark; give the model first")
        chosen = load_benchmark(benchmark, data, split, options, still)
    elif not isinstance(benchmark, Benchmark):
        raise UsageError("benchmark", f"a name or a Benchmark is needed, not {type(benchmark).__name__}")
    else:
        chosen = benchmark
        if given := [name for name, value in {"data": data, "split": split, "data_options": options}.items() if value]:
            raise UsageError(given[0], f"the benchmark '{chosen.name}' is already open: omit it")
        check_keys(chosen, f"the benchmark '{chosen.name}'")
    if isinstance(chosen.dataset, FromClips):
        chosen = replace(chosen, dataset=chosen.dataset.with_variant(variant))
    return chosen.still() if still else chosen
