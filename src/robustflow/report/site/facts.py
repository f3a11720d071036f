"""Facts about a run, or sources of published numbers, as (label, text) pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ...analysis.published.tables import method_of
from ...analysis.run_results import comparison_note
from ...benchmarks import benchmark_facts
from ...runs.costs import read_cost
from ...runs.plan import left_out_sentence
from ...text import plain

if TYPE_CHECKING:
    from ...runs.run import Run

_LONGEST = 600
_WITHOUT_TRAINING = {"knowledge": "none: not a learned method", "untrained": "none: its weights are random"}
Facts = list[tuple[str, str]]


def run_facts(run: Run) -> Facts:
    """Return facts about a run from its manifest: model, data, seed, versions, omitted data, and differences from the
    paper."""
    manifest, provenance = run.manifest, run.provenance
    frames, published = manifest.identity.frames, benchmark_facts(run.benchmark).published
    facts = [
        ("Model", _described(manifest.identity.model.settings)),
        ("Setting", run.setting),
        ("Trained on", _trained_on(run.setting, provenance.trained_on)),
        ("Evidence for the training data", provenance.basis),
        ("Note on training", provenance.note),
        ("Benchmark", f"{frames.benchmark} ({frames.dataset})"),
        ("Samples", str(len(manifest.samples))),
        ("Difference from the paper" if published else "Measured on", comparison_note(run)),
        ("Severities", ", ".join(map(str, manifest.selection.severities))),
        ("Severity scale", frames.severity_scale or "paper"),
        ("Left out", left_out_sentence(run.left_out) if run.left_out else ""),
        ("Seed", str(frames.seed)),
        ("Corruption variant", frames.variant),
        ("Cost", _cost(run)),
        ("Run", manifest.identity_digest),
        ("Packages", ", ".join(f"{name} {version}" for name, version in manifest.environment.packages.items())),
    ]
    return [(label, plain(text, _LONGEST)) for label, text in facts if text]


def published_facts(model: str, sources: list[str]) -> Facts:
    """Return facts about a model from the paper or a results file: its method, and the tables that contain its
    values."""
    method = method_of(model)
    facts = [("Source", ", ".join(source for source in sources if source))]
    if method is not None:
        facts += [
            ("Method", f"{method.method} ({method.type}, {method.year})"),
            ("Encoder", method.encoder),
            ("Decoder", method.decoder),
        ]
    return [(label, plain(text, _LONGEST)) for label, text in facts if text]


def _trained_on(setting: str, names: Sequence[str] | None) -> str:
    if setting in _WITHOUT_TRAINING:
        return _WITHOUT_TRAINING[setting]
    return "not declared" if names is None else ", ".join(names) or "nothing"


def _described(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}: {value}" for key, value in values.items() if value not in ({}, None, ""))


def _cost(run: Run) -> str:
    cost = read_cost(run)
    if cost is None:
        return ""
    size = f"{cost.parameters_m:.2f} M parameters, {cost.flops_g:.1f} G FLOPs for {cost.width} x {cost.height} frames"
    return size + (f", {cost.seconds:.3f} s on {cost.device}" if cost.seconds is not None else "")
