"""Prepare the paper's results for checking the observations. Statements about results, with the supporting numbers
and a verdict.

As in the paper's discussion (Sec. 5.2), the knowledge-driven methods and FlowDiffuser are left out, except in
statements about all models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean
from typing import Literal

from ...core.text import first_of
from ...core.types import FrozenFinite
from ...corruptions.registry import PAPER_ORDER
from ...data.benchmarks import benchmark_facts
from ..audit.findings import misfits
from ..cost_ranks import printed_cost_ranks
from ..model_result import ModelResult
from ..published.tables import Method, method_of, not_discussed
from ..results import AVERAGE, CLEAN, family_crer

ModelInSetting = tuple[str, str]
"""(setting, model)."""

_ROUNDING = 0.015
"""Largest combined error, in pixels, of three numbers rounded to hundredths."""


class Evidence:
    """The paper's results, by model."""

    def __init__(self, results: Sequence[ModelResult]) -> None:
        self.cost_ranks = printed_cost_ranks(results)
        self._without = not_discussed(results)
        self._epe: dict[ModelInSetting, dict[str, float]] = {}
        self.rcre: dict[ModelInSetting, dict[str, float]] = {}
        self._cre: dict[ModelInSetting, Mapping[str, float]] = {}
        self._printed_cre: dict[ModelInSetting, float] = {}
        for line in results:
            model = line.setting, line.name
            if not benchmark_facts(line.benchmark).has_flow:
                self.rcre[model] = line.numbers("rcre")
                continue
            self._epe[model] = line.numbers("epe")
            self._cre[model] = line.cre
            cre = line.values.get(("cre", AVERAGE))
            if cre is not None and cre.decimals is not None:
                self._printed_cre[model] = cre.number
        self.entries = list(self._epe)

    def discussed(self, setting: str, kind: str | None = None, encoder: str | None = None) -> list[ModelInSetting]:
        """Select the models of a setting, optionally by kind ("supervised", "unsupervised") and by encoder
        component."""
        chosen = []
        for entry in self.entries:
            method = self.method(entry[1])
            if entry[0] != setting or entry[1] in self._without:
                continue
            if kind is not None and method.type != kind:
                continue
            if encoder is not None and encoder not in method.encoder.split("+"):
                continue
            chosen.append(entry)
        return chosen

    def settings(self) -> list[str]:
        """List the settings with models, except "knowledge"."""
        return [name for name in dict.fromkeys(setting for setting, _ in self.entries) if name != "knowledge"]

    def method(self, model: str) -> Method:
        """Return the method of a model."""
        method = method_of(model)
        assert method is not None
        return method

    def family(self, entry: ModelInSetting) -> str:
        """Return the family of a model: all sizes of a method form one family."""
        return self.method(entry[1]).method

    def by_family(self, entries: Iterable[ModelInSetting], value: Callable[[ModelInSetting], float]) -> list[float]:
        """Return the mean value over each family's models, one per family in order of first appearance."""
        members: dict[str, list[float]] = {}
        for entry in entries:
            members.setdefault(self.family(entry), []).append(value(entry))
        return list(map(fmean, members.values()))

    def epe(self, entry: ModelInSetting, corruption: str = AVERAGE) -> float:
        """Return the mean EPE, in pixels."""
        return self._epe[entry][corruption]

    def clean(self, entry: ModelInSetting) -> float:
        """Return the EPE on the clean frames, in pixels."""
        return self._epe[entry][CLEAN]

    def cre(self, entry: ModelInSetting, corruption: str = AVERAGE) -> float:
        """Return the CRE, in pixels (`ModelResult.cre`)."""
        return self._cre[entry][corruption]

    def cre_text(self, entry: ModelInSetting) -> str:
        """Format the average CRE computed from the EPE, with the printed one if rounding cannot explain the
        difference."""
        computed, printed = self.cre(entry), self._printed_cre.get(entry)
        if printed is None or not misfits(printed, computed, _ROUNDING):
            return f"{computed:.2f}"
        return f"{computed:.2f} from the EPE (printed: {printed:.2f})"

    def log_ratio(self, entry: ModelInSetting) -> float:
        """Return ln(EPE / clean EPE), computed from the means."""
        return math.log(self.epe(entry) / self.clean(entry))

    def crer(self, entry: ModelInSetting, corruption: str = AVERAGE) -> float:
        """Return CRE / clean EPE."""
        return self.cre(entry, corruption) / self.clean(entry)

    def family_crer(self, entry: ModelInSetting, family: str) -> float:
        """Return the mean CREr over the corruptions of a family."""
        return family_crer(self._cre[entry], self.clean(entry))[family]

    def corruptions(self) -> list[str]:
        """List the corruptions of the EPE, in the paper's order."""
        return [name for name in PAPER_ORDER if name in self._epe[self.entries[0]]]


def named(entries: list[ModelInSetting]) -> str:
    """List the models for a sentence: "ID GMA, ID SKFlow"."""
    return first_of([" ".join(entry) for entry in entries], 6) or "none"


Verdict = Literal["holds", "does not hold", "too little evidence", "cannot be computed"]
UNKNOWN: Verdict = "cannot be computed"
THIN: Verdict = "too little evidence"


class Statement(FrozenFinite):
    """One statement in an observation, checked by a computation."""

    claim: str
    verdict: Verdict
    message: str
    numbers: dict[str, float] = {}
    main: bool = False


class Observation(FrozenFinite):
    """An observation from the paper."""

    number: int
    title: str
    parts: list[Statement]

    @property
    def verdict(self) -> Verdict:
        """The joint verdict on the main parts."""
        verdicts = [part.verdict for part in self.parts if part.main]
        if "does not hold" in verdicts:
            return "does not hold"
        return THIN if THIN in verdicts else "holds"


def part(
    claim: str, verdict: Verdict, message: str, main: bool = False, numbers: dict[str, float] | None = None
) -> Statement:
    """Create a statement."""
    return Statement(claim=claim, verdict=verdict, message=message, numbers=numbers or {}, main=main)
