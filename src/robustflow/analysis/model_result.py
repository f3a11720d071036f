"""`ModelResult`: one line of any table, from a run, the paper, or a results file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from ..errors import DataError
from ..metrics.summary import has_gaps
from ..runs.costs import RunCost, read_cost
from ..text import plain
from .results import AVERAGE, CLEAN
from .uncertainty.of_runs import IntervalEnds, interval_ends

if TYPE_CHECKING:
    from ..runs.run import Run

ValueKey = tuple[str, str]
"""(metric, condition): the condition is a corruption, "clean" or "average"."""

_UNROUNDED = 1e-9
"""The relative error of a number that was not rounded for a reader."""


@dataclass(frozen=True)
class Value:
    """A number, its digits after the point as printed (None if it was not rounded), whether its source sets it in bold
    (None if it marks nothing), and the source."""

    number: float
    decimals: int | None = None
    marked: bool | None = None
    source: str = ""

    @property
    def text(self) -> str:
        """The number as it was printed, or with two decimals.

        >>> Value(4.2, 2).text, Value(1.23456).text
        ('4.20', '1.23')
        """
        return f"{self.number:.{2 if self.decimals is None else self.decimals}f}"

    @property
    def half(self) -> float:
        """Half a unit of the last printed digit: the exact value is at most that far off.

        >>> Value(4.2, 2).half
        0.005
        """
        return _UNROUNDED * max(1.0, abs(self.number)) if self.decimals is None else 0.5 * 10.0**-self.decimals


@dataclass(frozen=True, eq=False)
class ModelResult:
    """One line of any table. What follows from a run's rows is computed when it is asked for, once.

    Attributes:
        benchmark, setting, name: what was measured, what the training means for it, and the model.
        frames: lines with the same value can be compared.
        note: what a reader must know before comparing; "" for nothing.
        values: (metric, condition) -> value.
        run: whose line it is; None for the paper and results files.
        beside_published: whether averages are over the paper's corruptions only, to compare with the published ones.
        detailed: whether each corruption has an interval, or only the averages.
        exclusion: gives `excluded`, which depends on the runs that this one was read with.
    """

    benchmark: str
    frames: str
    setting: str
    name: str
    note: str
    values: Mapping[ValueKey, Value]
    run: Run | None = None
    beside_published: bool = False
    detailed: bool = True
    exclusion: Callable[[], str] = field(default=str, repr=False)

    @property
    def key(self) -> tuple[str, str]:
        """(frames, name), by which the lines of runs are unique."""
        return self.frames, self.name

    @cached_property
    def excluded(self) -> str:
        """Why the model is not ranked; "" for one that is."""
        return self.exclusion()

    @cached_property
    def cost(self) -> RunCost | None:
        """The cost counted for the run's model."""
        return read_cost(self.run) if self.run else None

    @cached_property
    def coverage(self) -> float | None:
        """The share of the pixels that the errors are over, if the model left out any."""
        return self.run.summary.coverage if self.run and has_gaps(self.run.summary) else None

    @cached_property
    def pairs(self) -> int | None:
        """The number of pairs of a run."""
        return self.run.summary.samples if self.run else None

    @cached_property
    def crer(self) -> float | None:
        """The average CREr: as given, or computed from the average and the clean EPE."""
        given, clean, epe = (self.number(*key) for key in (("crer", AVERAGE), ("epe", CLEAN), ("epe", AVERAGE)))
        if given is None and epe is not None and clean:
            given = (epe - clean) / clean
        return given

    @cached_property
    def intervals(self) -> Mapping[ValueKey, IntervalEnds]:
        """The 95 % intervals of a run's means, also of families of corruptions, see `interval_ends`; empty for
        others."""
        return interval_ends(self.run, self.detailed, self.beside_published) if self.run else {}

    def number(self, metric: str, condition: str) -> float | None:
        """A value as a number; None if there is none."""
        value = self.values.get((metric, condition))
        return None if value is None else value.number

    def numbers(self, metric: str) -> dict[str, float]:
        """Condition -> value of a metric."""
        return {of: value.number for (kind, of), value in self.values.items() if kind == metric}


def merged(lines: Iterable[ModelResult], where: str = "") -> list[ModelResult]:
    """Merge the lines of one benchmark, sample set, setting and name, in the order in which they begin; the first one's
    note is kept. `where` is for messages.

    Raises:
        DataError: two of them have the same value.
    """
    parts: dict[tuple[str, str, str, str], list[ModelResult]] = {}
    for line in lines:
        parts.setdefault((line.benchmark, line.frames, line.setting, line.name), []).append(line)
    return [one[0] if len(one) == 1 else replace(one[0], values=_joined(one, where)) for one in parts.values()]


def _joined(lines: Sequence[ModelResult], where: str) -> dict[ValueKey, Value]:
    values: dict[ValueKey, Value] = {}
    for line in lines:
        for metric, condition in values.keys() & line.values.keys():
            whose = f"'{plain(line.name)}' ({plain(line.setting)})"
            raise DataError(
                f"{where}{': ' if where else ''}{metric} of {whose} on {condition} appears twice for the sample set "
                f"'{plain(line.frames)}'; give each value once"
            )
        values |= line.values
    return values


def ranked(results: Iterable[ModelResult]) -> list[ModelResult]:
    """The lines without those whose model is not ranked, for statements about models in general."""
    return [line for line in results if not line.excluded]


def not_ranked(results: Iterable[ModelResult]) -> list[str]:
    """A sentence for each line whose model is not ranked."""
    return [plain(f"Not ranked: {line.name}, because {line.excluded}.", None) for line in results if line.excluded]


def by_frames(results: Iterable[ModelResult]) -> dict[str, Sequence[ModelResult]]:
    """frames -> the lines that can be compared."""
    groups: dict[str, list[ModelResult]] = {}
    for line in results:
        groups.setdefault(line.frames, []).append(line)
    return dict(groups)
