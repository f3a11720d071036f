"""Unique names for several runs: the model's name, plus the differences between runs with the same name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from ..digest import digest_of_value
from ..runs.comparable import recipe_in_words
from ..severity import SEVERITIES
from ..text import counted, plain
from .labels import benchmark_label

if TYPE_CHECKING:
    from ..runs.run import Run

AnyRun = TypeVar("AnyRun", bound="Run")

_MOST_NAMED = 3
_LONGEST_VALUE = 24
_DIGITS = 8
_MODEL = "model "
_NOT_A_DIFFERENCE = {"name", "spec", "object", "source", "options"}
"""Parts of a model's identity that its name already contains or that follow from other parts."""


def run_names(runs: Sequence[Run]) -> list[str]:
    """Give each run a unique name: the model's name, followed by what differs between runs with the same name, such as
    the benchmark, a model option or the seed, or by the run's digest (and a number) if nothing readable differs."""
    of_name: dict[str, list[int]] = {}
    for index, run in enumerate(runs):
        of_name.setdefault(run.name, []).append(index)
    candidates = [""] * len(runs)
    for name, indices in of_name.items():
        for index, words in zip(indices, _differences([runs[index] for index in indices]), strict=True):
            candidates[index] = f"{name} ({', '.join(words)})" if words else name
    counts: Counter[str] = Counter()
    names = []
    for name in candidates:
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name} #{counts[name]}")
    return names


def named_runs(runs: Sequence[AnyRun]) -> dict[str, AnyRun]:
    """Return the runs by their `run_names`."""
    return dict(zip(run_names(runs), runs, strict=True))


def _differences(runs: Sequence[Run]) -> list[list[str]]:
    """Select, for runs with the same name, the fewest facts (in the order of `_facts`) that distinguish the runs and
    their models."""
    facts = [dict(_facts(run)) for run in runs]
    keys = list(dict.fromkeys(key for known in facts for key in known))
    telling = {*_needed(facts, keys), *_needed(facts, [key for key in keys if key.startswith(_MODEL)])}
    chosen = [[known.get(key, "") for key in keys if key in telling] for known in facts]
    same = Counter(map(tuple, chosen))
    return [
        [*filter(None, words)] + ([run.manifest.identity_digest[:_DIGITS]] if same[tuple(words)] > 1 else [])
        for words, run in zip(chosen, runs, strict=True)
    ]


def _needed(facts: Sequence[Mapping[str, str]], keys: Sequence[str]) -> list[str]:
    """Select keys that distinguish the facts, skipping keys that add nothing to the previous ones."""
    chosen: list[str] = []
    groups = 1
    for key in keys:
        finer = len({tuple(known.get(name, "") for name in (*chosen, key)) for known in facts})
        if finer > groups:
            chosen.append(key)
            groups = finer
    return chosen


def _facts(run: Run) -> Iterator[tuple[str, str]]:
    """Yield (key, description) of everything that may differ between runs with the same name, most informative
    first."""
    identity, planned = run.manifest.identity, run.manifest
    yield "benchmark", benchmark_label(run.benchmark)
    yield "dataset", plain(identity.frames.dataset, _LONGEST_VALUE)
    trained_on = run.provenance.trained_on
    yield (
        f"{_MODEL}trained on",
        "training not stated" if trained_on is None else f"trained on {_named(trained_on, 'set')}",
    )
    for key, value in _texts(identity.model.settings):
        yield f"{_MODEL}{key}", f"{plain(key.replace('_', ' '), _LONGEST_VALUE)} {value}"
    for part, words in recipe_in_words(run):
        if part not in ("benchmark", "dataset"):
            yield part, words
    yield "corruptions", _named(planned.corruptions, "corruption")
    yield "severities", "severities " + ", ".join(map(str, planned.severities or SEVERITIES))
    yield "samples", counted(len(run.manifest.samples), "pair")
    yield "files", f"files {digest_of_value(dict(run.manifest.file_digests))[:_DIGITS]}"


def _texts(model: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the settings of a model as text, with digests shortened to their first digits."""
    options = model.get("options") or {}
    for key, value in {**(options if isinstance(options, Mapping) else {}), **model}.items():
        if key not in _NOT_A_DIFFERENCE:
            text = plain(str(value), _LONGEST_VALUE)
            yield key, text[:_DIGITS] if len(str(value)) == 64 else text


def _named(names: Sequence[str], noun: str) -> str:
    """List the names if there are few, otherwise return their number."""
    if len(names) > _MOST_NAMED:
        return counted(len(names), noun)
    return "+".join(plain(str(name), _LONGEST_VALUE) for name in names) or "nothing"
