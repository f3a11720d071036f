"""How far a model's flow moves on RobustSpring, as results that a leaderboard shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import fsum
from typing import Protocol

from ..corruptions.on_disk import ROBUSTSPRING
from ..runs.comparable import sample_set_of
from ..runs.run import Run
from ..text import counted, joined
from .labels import inside, long_label
from .model_result import ModelResult, Value
from .results import AVERAGE
from .run_results import OWN_SETTING

ROBUSTNESS = ("epe", "fl", "px1")
"""RobustSpring's three numbers of a corrupted flow: the distance to the clean one in pixels, and the percentages of
pixels that it moves by more than Fl's bounds and by more than 1 px."""

_MOST_NAMED = 3


class MovedFlow(Protocol):
    """A flow of an export, as `robustflow.runner.submission.Submitted` has it."""

    @property
    def condition(self) -> str:
        """A corruption of RobustSpring, or "clean"."""

    @property
    def key(self) -> str:
        """The pair's key."""

    @property
    def frames(self) -> str:
        """The digest of the files of its frames."""

    @property
    def moved(self) -> Sequence[float] | None:
        """The numbers of `ROBUSTNESS`; None for the clean flow."""


def robustspring_results(run: Run, flows: Iterable[MovedFlow]) -> ModelResult:
    """RCRE per corruption and their mean. Results over the same corruptions of the same frames are one sample set.

    Args:
        run: whose model predicted.
        flows: the clean ones and those under at least one corruption.
    """
    flows = list(flows)
    moved: dict[str, list[float]] = {}
    for flow in flows:
        if flow.moved is not None:
            moved.setdefault(ROBUSTSPRING.local_name(flow.condition), []).append(flow.moved[0])
    means = {name: fsum(values) / len(values) for name, values in moved.items()}
    few = joined([inside(long_label(name)) for name in moved]) if len(moved) <= _MOST_NAMED else ""
    pairs = min(len(values) for values in moved.values())
    note = f"{counted(pairs, 'pair')}, all pixels; average over {few or counted(len(moved), 'corruption')}"
    means[AVERAGE] = fsum(means.values()) / len(means)
    cells = [(flow.key, flow.condition, int(flow.moved is not None), flow.frames, None) for flow in flows]
    frames = f"{ROBUSTSPRING.title}, {note}; frames {sample_set_of('', cells)}"
    values = {("rcre", name): Value(value, source=run.manifest.identity_digest) for name, value in means.items()}
    return ModelResult(ROBUSTSPRING.dataset, frames, _setting(run), run.name, note, values)


def robustness_means(moved: Mapping[str, Sequence[Sequence[float]]]) -> dict[str, tuple[int, list[float]]]:
    """Corruption -> number of pairs and the means of `ROBUSTNESS` over them; "average" is the mean over corruptions.

    Args:
        moved: RobustSpring's own name of a corruption -> of each pair the numbers of `ROBUSTNESS`.
    """
    means = {ROBUSTSPRING.local_name(own): _columns(values) for own, values in moved.items()}
    pairs = {ROBUSTSPRING.local_name(own): len(values) for own, values in moved.items()}
    table = {name: (pairs[name], values) for name, values in means.items()}
    return table | {AVERAGE: (min(pairs.values()), _columns(list(means.values())))}


def robustness_csv(means: Mapping[str, tuple[int, Sequence[float]]]) -> str:
    """`robustness_means` as a file.

    >>> print(robustness_csv({"robustspring_fog": (4, [0.5, 2.0, 10.0])}), end="")
    corruption,pairs,epe,fl,px1
    robustspring_fog,4,0.5,2.0,10.0
    """
    lines = [",".join([name, str(pairs), *map(repr, values)]) for name, (pairs, values) in means.items()]
    return "\n".join([",".join(("corruption", "pairs", *ROBUSTNESS)), *lines]) + "\n"


def _columns(values: Sequence[Sequence[float]]) -> list[float]:
    return [fsum(column) / len(values) for column in zip(*values, strict=True)]


def _setting(run: Run) -> str:
    """What the model's training means for RobustSpring's frames, whatever the run was on."""
    manifest = run.manifest
    setting = manifest.provenance.on(
        ROBUSTSPRING.dataset, list(manifest.samples), manifest.identity.frames.protocol
    ).setting
    return OWN_SETTING if setting == "UNKNOWN" else setting
