"""The results frame by line: the numbers of one model in one setting on one sample set."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any, NamedTuple

import polars as pl

from ..corruptions.registry import MEMBERS, ordered
from ..metrics.cube import PAPER, MeanKey, Means
from ..metrics.error_maps import crer
from ..metrics.measures import LEADING
from ..metrics.regions import REGIONS
from .frame import DERIVED, LINE, MEASURED, once
from .intervals import IntervalEnds
from .results import AVERAGE, CLEAN, family_crer, family_means

PARAMETERS: MeanKey = ("parameters", "", None)
FLOPS: MeanKey = ("flops", "", None)
CRER: MeanKey = ("crer", AVERAGE, None)
RANKS: dict[str, MeanKey] = {name: (f"{name}_rank", "", None) for name in ("flops", "crer", "average")}
"""The ranks that the paper's Tab. 3 prints."""

Row = Mapping[str, Any]
"""A row of the results frame."""
_WHOLES = {"", CLEAN, AVERAGE, PAPER, *MEMBERS, *REGIONS}


class LineKey(NamedTuple):
    """What tells a line from the others: the columns `LINE` of the frame."""

    benchmark: str
    sample_set: str
    setting: str
    model: str

    @property
    def comparable(self) -> tuple[str, str, str]:
        """What lines have in common that are ranked together: benchmark, sample set and setting."""
        return self[:3]


class Numbers(dict[MeanKey, Row]):
    """The rows of one line by (measure, condition, severity), without its tests."""

    def number(self, measure: str, condition: str, severity: int | None = None) -> float | None:
        """Return a number; None if there is none."""
        row = self.get((measure, condition, severity))
        return None if row is None else row["value"]

    def ends(self, measure: str, condition: str, severity: int | None = None) -> IntervalEnds | None:
        """Return the ends of an interval; None if there is none."""
        row = self.get((measure, condition, severity))
        return None if row is None or row["low"] is None else (row["low"], row["high"])

    @property
    def means(self) -> Means:
        """The value of each row."""
        return {key: row["value"] for key, row in self.items()}

    def fact(self, name: str) -> Any:
        """Return what all rows of the line have in common: its `source`, `note` or the reason why it is `excluded`."""
        return next(iter(self.values()))[name]

    @property
    def coverage(self) -> float | None:
        """The lowest share of the pixels that an error includes; None for all."""
        return min((row["coverage"] for row in self.values() if row["coverage"] is not None), default=None)

    @property
    def is_run(self) -> bool:
        """Whether the line is of a run."""
        return self.fact("source") in MEASURED

    @property
    def has_gaps(self) -> bool:
        """Whether some pixels have no prediction, so that tables need a column `coverage`."""
        return any((self.number("coverage", of) or 1.0) < 1 for of in (CLEAN, *self.corruptions()))

    def corruptions(self, measures: Container[str] | None = None) -> list[str]:
        """Return the corruptions with a number of one of the measures, by default of any, in the order of tables."""
        attacks = {of for name, of, _ in self if name == "attack_budget"}
        known = {of for name, of, _ in self if measures is None or name in measures}
        return ordered(known - _WHOLES - attacks)

    def severities(self) -> list[int]:
        """Return the severities of the corruptions."""
        names = set(self.corruptions())
        return sorted({at for _, of, at in self if at is not None and of in names})

    def by_corruption(self, measure: str) -> dict[str, float]:
        """Return a measure under each single corruption, over severities."""
        names = self.corruptions((measure,))
        return {of: value for of in names if (value := self.number(measure, of)) is not None}

    def changes(self) -> dict[str, float]:
        """Return the CRE by corruption, and "average": as measured, over the pixels that have a flow on both the clean
        and the corrupted frames. Where only a rounded CRE or none is given, it is EPE - clean EPE, because the
        published CRE does not match the published EPE (see `robustflow reproduce audit`)."""
        clean = self.number(LEADING, CLEAN)
        known = {measure: self._averaged(measure) for measure in (LEADING, "cre")}
        made = {} if clean is None else {of: row["value"] - clean for of, row in known[LEADING].items()}
        return made | {of: row["value"] for of, row in known["cre"].items() if row["decimals"] is None}

    def _averaged(self, measure: str) -> dict[str, Row]:
        wanted = (AVERAGE, *self.by_corruption(measure))
        return {of: self[measure, of, None] for of in wanted if (measure, of, None) in self}

    def family_crer(self) -> dict[str, float]:
        """Return the known CREr of each family."""
        return {of: value for of in MEMBERS if (value := self.number("crer", of)) is not None}

    def may_be_best(self, key: LineKey, measure: str) -> bool:
        """Return whether the lowest value of a measure may be marked: of runs, only the EPE, because a flow that is too
        short has a lower CRE, CREr and RCRE than the sound flow; of the paper, all of them."""
        if key.setting == "knowledge":
            return False
        return self.fact("source") == "published" or (self.is_run and measure == LEADING)


Lines = Mapping[LineKey, Numbers]


def lines_of(frame: pl.DataFrame) -> dict[LineKey, Numbers]:
    """Return the lines of a results frame in order of first appearance. Lines without rows (published, claimed) also
    have what follows from their numbers: the means over families of corruptions and the CREr (`DERIVED`)."""
    lines: dict[LineKey, Numbers] = {}
    shown = once(frame).filter(pl.col("against").is_null()).select(*LINE, *_SHOWN)
    for row in shown.iter_rows(named=True):
        of_line = lines.setdefault(LineKey(*(row[name] for name in LINE)), Numbers())
        of_line[row["measure"], row["condition"], row["severity"]] = row
    for of_line in lines.values():
        if not of_line.is_run:
            some = next(iter(of_line.values()))
            blank = dict.fromkeys(("decimals", "marked", "low", "high", "letter"))
            for key, value in _derived(of_line).items():
                named = dict(zip(("measure", "condition", "severity"), key, strict=True))
                of_line.setdefault(key, dict(some) | blank | named | {"value": value, "origin": DERIVED})
    return lines


_SHOWN = (
    *("measure", "condition", "severity", "value", "low", "high", "deviation", "log_deviation", "letter"),
    *("decimals", "marked", "origin", "source", "note", "coverage", "excluded", "pairs"),
)


def _derived(numbers: Numbers) -> dict[MeanKey, float]:
    """Compute what a line does not give: the means over families, and the CREr from the CRE and the clean EPE."""
    made: dict[MeanKey, float] = {}
    for measure in ("epe", "cre", "rcre"):
        means = family_means(numbers.by_corruption(measure))
        made |= {(measure, family, None): mean for family, mean in means.items()}
    cre, clean = numbers.changes(), numbers.number("epe", CLEAN)
    if clean is not None:
        made |= {("crer", family, None): ratio for family, ratio in family_crer(cre, clean).items()}
        if (of_average := crer(cre.get(AVERAGE), clean)) is not None:
            made[CRER] = of_average
    return made


def number_of(row: Row) -> str:
    """Return a number as text, with as many decimals as printed, or with two if it was not rounded."""
    return f"{row['value']:.{2 if row['decimals'] is None else row['decimals']}f}"


def ranked(lines: Lines) -> dict[LineKey, Numbers]:
    """Select the lines whose model is ranked, for statements about models in general."""
    return {key: numbers for key, numbers in lines.items() if not numbers.fact("excluded")}


def by_sample_set(lines: Lines) -> dict[str, dict[LineKey, Numbers]]:
    """Group the lines by sample set, within which they can be compared."""
    groups: dict[str, dict[LineKey, Numbers]] = {}
    for key, numbers in lines.items():
        groups.setdefault(key.sample_set, {})[key] = numbers
    return groups
