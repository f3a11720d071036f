"""Which of several models of one setting on the same frames leads, if any, and why.

With ground truth, the lowest EPE under corruption leads if it is shown to be lower than that of every other model, and
no other is shown to be better on the clean frames. Without it, a flow that ignores the frames has the lowest RCRE, so a
model leads only if it is shown to be better in RCRE and in the photometric error (on the clean frames, of the flow from
the corrupted ones), and no other is shown to explain the clean frames better with its clean flow.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import polars as pl

from ..core.errors import RunError
from ..core.text import counted, first_of, joined, plain
from ..metrics.cube import AVERAGE, Cube
from ..metrics.measures import LABELS, LEADING, MEASURES, UNCOUPLED
from ..metrics.rows import CLEAN
from ..run.comparable import common_rows
from .estimate import BLOW_UP, CONTRASTS, OVERALL_SCOPES, contrast, cubes_of
from .inference import FEWEST
from .paired import better_of, group_letters, is_sure, worse_of

Kind = Literal["leads", "trade-off", "not decided", "not tested"]
WITHOUT_TRUTH = ("rcre", "photometric")
"""The measures in which a leader must be better without ground truth."""
_MOST_NAMED = 3
_EXPLAIN = {
    name: measure
    for name, measure in (MEASURES | UNCOUPLED).items()
    if measure.verdict == "explains" and name != "rcre_all"  # nearly the same as RCRE
}


@dataclass(frozen=True)
class Verdict:
    """What may be said about the models of one setting on the same frames.

    Attributes:
        kind: "leads", "trade-off", "not decided" or "not tested".
        names: the model with the lowest error; then those that are better on the clean frames ("trade-off") or that
            cannot be told apart from it ("not decided").
        measures: the measures that decide.
        tested: the number of models that were compared.
        letters: the group letters by the EPE.
        remarks: sentences beside the verdict.
    """

    kind: Kind
    names: tuple[str, ...] = ()
    measures: tuple[str, ...] = ()
    tested: int = 0
    letters: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def ending(self, tested: str = "the others") -> str:
        """Return what follows "A has the lowest EPE; ", where a test says something about A and those `tested`."""
        labels = joined([LABELS[name] for name in self.measures])
        if self.kind == "leads":
            also = f" in {labels}" if len(self.measures) > 1 else ""
            return f"this is significantly lower{also} than {tested}"
        others = self.names[1:]
        if self.kind == "trade-off":
            better = f"{_names(others)} {'is' if len(others) == 1 else 'are'} significantly better on the clean frames"
            return f"{better}, so it is a trade-off and none is the most robust"
        both = f" in both {labels}" if len(self.measures) > 1 else ""
        return f"{_names(others)} cannot be told apart from it{both}" if others else "these differences are not tested"

    @property
    def sentence(self) -> str:
        """The verdict and its remarks in words; "" if nothing was tested."""
        if self.kind == "not tested":
            return ""
        lowest = f"{plain(self.names[0])} has the lowest {LABELS[self.measures[0]]} under corruption; {self.ending()}."
        return " ".join([lowest, *self.remarks])


def _names(names: Sequence[str]) -> str:
    shown = [plain(name) for name in names]
    return first_of(shown, _MOST_NAMED) if len(shown) > _MOST_NAMED else joined(shown)


def compared(rows: Mapping[str, pl.DataFrame], *, explained: bool = True) -> pl.DataFrame:
    """Return what decides between several models, from their rows by name, as part of a results frame: the tests of
    every two of them in the measures that decide and, if it is to be `explained`, the means that remarks are about.
    Fewer than two models, or models without anything in common, have no tests."""
    if len(rows) < 2:
        return pl.DataFrame(schema=CONTRASTS)
    try:
        common, _ = common_rows(list(rows.values()), list(rows))
        cubes = cubes_of(dict(zip(rows, common, strict=True)))
        known = (some for some in ((LEADING,), WITHOUT_TRUTH) if _known(some, cubes.values()))
        decisive = {name: MEASURES[name] for name in next(known, WITHOUT_TRUTH[:1])}
        tests = contrast(cubes, decisive, OVERALL_SCOPES)
    except RunError:
        return pl.DataFrame(schema=CONTRASTS)
    beside = {**_EXPLAIN, "photometric": MEASURES["photometric"]} if explained else {}
    means = [
        (model, name, *at, value)
        for model, cube in cubes.items()
        for (name, *at), value in cube.means(beside, [(AVERAGE, None)]).items()
    ]
    columns = {name: CONTRASTS[name] for name in ("model", "measure", "condition", "severity", "value")}
    return pl.concat([pl.DataFrame(means, columns, orient="row"), tests], how="diagonal")


def _known(measures: Sequence[str], cubes: Iterable[Cube]) -> bool:
    return all(cube.mean(MEASURES[name], AVERAGE) is not None for cube in cubes for name in measures)


_Means = Mapping[tuple[str, str], float]
"""Means over all corruptions by model and measure."""


def verdict_of(frame: pl.DataFrame) -> Verdict:
    """Return the verdict on the ranked models of one setting on the same frames, from their tests and means: rows of
    the results frame, or of `compared`."""
    whole = frame.filter(pl.col("severity").is_null())
    tests = whole.filter(pl.col("against").is_not_null())
    known = set(tests["measure"])
    measures = tuple(name for name in ((LEADING,) if LEADING in known else WITHOUT_TRUTH) if name in known)
    if not measures:
        return Verdict("not tested")
    averages = whole.filter(pl.col("against").is_null(), condition=AVERAGE).select("model", "measure", "value")
    means = {(model, measure): value for model, measure, value in averages.iter_rows()}
    return _decided(measures, tests.filter(pl.col("measure").is_in(measures)).to_dicts(), means)


def _decided(measures: tuple[str, ...], tests: Sequence[dict[str, Any]], means: _Means) -> Verdict:
    """Decide from the tests of every two models on the clean frames and on average."""
    shown = {(row["measure"], row["condition"], better_of(row), worse_of(row)) for row in filter(is_sure, tests)}
    led = [row for row in tests if (row["measure"], row["condition"]) == (measures[0], AVERAGE)]
    errors = {row[whose]: row[f"value_{whose}"] for row in led for whose in ("model", "against")}
    first, *others = sorted(errors, key=lambda name: (errors[name], name))
    beyond_rcre = len(measures) > 1 or measures[0] == LEADING
    tied = [o for o in others if not beyond_rcre or any((m, AVERAGE, first, o) not in shown for m in measures)]
    cleaner = [o for o in others if (measures[-1], CLEAN, o, first) in shown]
    kind: Kind = "not decided" if tied else "trade-off" if cleaner else "leads"
    open_pairs = [{first, name} for name in tied]
    of_first = [row for row in tests if {row["model"], row["against"]} in open_pairs and row["condition"] == AVERAGE]
    remarks = [*_reservations(first, of_first), *_clean_remark(cleaner if tied else ())]
    letters = group_letters(led, [first, *others]) if measures[0] == LEADING else {}
    if measures[0] == LEADING:
        worse = [o for o in others if (LEADING, AVERAGE, first, o) in shown]
        remarks += _reversals(first, worse, means)
    else:
        remarks += _photometric_remark(first, [first, *others], means)
    return Verdict(kind, (first, *(tied or cleaner)), measures, 1 + len(others), letters, tuple(remarks))


def _reservations(first: str, of_first: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say why tests of the lowest model conclude less than their numbers suggest."""
    remarks = []
    if any(row["p"] is None for row in of_first):
        remarks.append(f"Fewer than {FEWEST} independent images are not enough for a test.")
    less = {better_of(row) for row in of_first if row["fewer_pixels"] == better_of(row)}
    remarks += [
        f"{plain(name)} predicted fewer pixels than others, and its errors cover only these: it is not called better."
        for name in sorted(less)
    ]
    for row in of_first:
        for whose, other in (("model", "against"), ("against", "model")):
            if row["measure"] == of_first[0]["measure"] and (count := row[f"blow_ups_{whose}"]):
                times = f"over {BLOW_UP:g} times that of {plain(row[other])}"
                remarks.append(f"On {counted(count, 'image')}, the error of {plain(row[whose])} is {times}.")
    return remarks


def _clean_remark(cleaner: Sequence[str]) -> list[str]:
    return [f"On the clean frames, {_names(cleaner)} {'is' if len(cleaner) == 1 else 'are'} better."] if cleaner else []


def _reversals(first: str, worse: Sequence[str], means: _Means) -> list[str]:
    """Name the measures that prefer a model whose EPE is shown to be higher than that of the first one."""
    by_names: dict[tuple[str, ...], list[str]] = {}
    for name, measure in _EXPLAIN.items():
        least = means.get((first, name))
        ahead = tuple(model for model in worse if _is_visibly_less(means.get((model, name)), least))
        if ahead:
            by_names.setdefault(ahead, []).append(measure.label)
    return [
        f"By {joined(labels)}, {_names(ahead)} would come before {plain(first)}, whose EPE is "
        "lower: large clean errors and short flows change less."
        for ahead, labels in by_names.items()
    ]


def _is_visibly_less(value: float | None, least: float | None) -> bool:
    return value is not None and least is not None and value < least and f"{least - value:.2f}" != "0.00"


def _photometric_remark(first: str, models: Iterable[str], means: _Means) -> list[str]:
    """Say which flow from the corrupted frames explains the clean frames best, if it is not that with the lowest
    RCRE."""
    errors = {name: means.get((name, "photometric")) for name in models}
    known = {name: error for name, error in errors.items() if error is not None}
    if first not in known or (best := min(known, key=lambda name: known[name])) == first:
        return []
    numbers = f"{known[best]:.2f}, not {known[first]:.2f} grey levels"
    return [f"The flow of {plain(best)} explains the frames better (photometric error {numbers})."]
