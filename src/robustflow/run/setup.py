"""Set up one run from a request: benchmark, model and options."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.errors import UsageError
from ..corruptions.corruption import BGR, VARIANTS
from ..data.benchmarks import Benchmark, benchmark_facts, load_benchmark
from ..data.benchmarks.facts import check_still, is_still
from ..data.benchmarks.registry import check_keys
from ..data.datasets.dataset import FromClips
from ..models import MODELS, ModelRef
from ..models.confidence import check_confidence
from ..models.protocols import AnyModel, BatchedFlowModel, ClipModel, FlowLookup
from .config import DEFAULTS, RunConfig, Selection
from .identity import checked_name
from .manifest import left_out_sentence
from .plan import NamedModel, Plan, load_corruptions, name_model


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
    if size > 1 and isinstance(model, ClipModel):
        raise UsageError("--batch-size", "a multi-frame model predicts one clip at a time; omit it")
    if size > 1 and not isinstance(model, BatchedFlowModel):
        raise UsageError("--batch-size", "the model has no method predict_batch; omit it")


def open_selection(chosen: Selection, variant: str) -> Benchmark:
    """Open the benchmark of a request, with the conditions and the pairs that it names."""
    conditions = chosen.corruptions, chosen.severities, chosen.attacks
    if chosen.subset is not None and (chosen.still or any(given is not None for given in conditions)):
        raise UsageError(
            "a subset defines its own corruptions and severities; it cannot be combined with "
            "corruptions, severities, attacks or still"
        )
    opened = open_benchmark(chosen.benchmark, chosen.data, chosen.split, chosen.data_options, variant, chosen.still)
    within = opened if chosen.subset is None else opened.subset(chosen.subset)
    return within.narrowed(chosen.corruptions, chosen.severities, chosen.limit, chosen.attacks)


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
