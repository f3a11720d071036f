"""The paper's results by model, and the statements that follow from them.

As in the paper's discussion (Sec. 5.2), the knowledge-driven methods and FlowDiffuser are left out, except in
statements about all models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Literal

from ..corruptions.registry import PAPER_ORDER
from ..data.benchmarks import benchmark_facts
from ..report.table import DASH
from ..stats.lines import Lines
from ..stats.published.tables import Method, cost_ranks, method_of, not_discussed
from ..stats.results import AVERAGE, CLEAN, family_crer
from .margin import Margin, Verdict, joint

ModelInSetting = tuple[str, str]
"""(setting, model)."""

Part = Literal["main", "also", "added"]


class Evidence:
    """The paper's results, by model."""

    def __init__(self, lines: Lines) -> None:
        self.cost_ranks = cost_ranks(lines)
        self._without = not_discussed(lines)
        self._epe: dict[ModelInSetting, dict[str, float]] = {}
        self.rcre: dict[ModelInSetting, dict[str, float]] = {}
        self._cre: dict[ModelInSetting, Mapping[str, float]] = {}
        for key, numbers in lines.items():
            model, has_flow = (key.setting, key.model), benchmark_facts(key.benchmark).has_flow
            metric = "epe" if has_flow else "rcre"
            values = {of: number for of in (CLEAN, AVERAGE) if (number := numbers.number(metric, of)) is not None}
            values |= numbers.by_corruption(metric)
            if has_flow:
                self._epe[model], self._cre[model] = values, numbers.changes()
            else:
                self.rcre[model] = values
        self.entries = list(self._epe)
        self.settings = [name for name in dict.fromkeys(setting for setting, _ in self.entries) if name != "knowledge"]
        self.corruptions = [name for name in PAPER_ORDER if name in self._epe[self.entries[0]]]

    def discussed(self, setting: str, kind: str | None = None, encoder: str | None = None) -> list[ModelInSetting]:
        """Select the models of a setting, optionally by kind ("supervised", "unsupervised") and by encoder."""
        return [
            entry
            for entry in self.entries
            if entry[0] == setting
            and entry[1] not in self._without
            and kind in (None, self.method(entry).type)
            and (encoder is None or encoder in self.method(entry).encoder.split("+"))
        ]

    def method(self, entry: ModelInSetting) -> Method:
        """Return the method of a model; all sizes of a method form one family."""
        method = method_of(entry[1])
        assert method is not None
        return method

    def by_family(self, entries: Iterable[ModelInSetting], value: Callable[[ModelInSetting], float]) -> list[float]:
        """Return the mean value over each family's models, one per family in order of first appearance."""
        members: dict[str, list[float]] = {}
        for entry in entries:
            members.setdefault(self.method(entry).method, []).append(value(entry))
        return list(map(fmean, members.values()))

    def epe(self, entry: ModelInSetting, corruption: str = AVERAGE) -> float:
        """Return the mean EPE, in pixels."""
        return self._epe[entry][corruption]

    def clean(self, entry: ModelInSetting) -> float:
        """Return the EPE on the clean frames, in pixels."""
        return self._epe[entry][CLEAN]

    def cre(self, entry: ModelInSetting, corruption: str = AVERAGE) -> float:
        """Return the CRE computed from the EPE, in pixels; some printed ones differ."""
        return self._cre[entry][corruption]

    def log_ratio(self, entry: ModelInSetting) -> float:
        """Return ln(EPE / clean EPE), computed from the means."""
        return math.log(self.epe(entry) / self.clean(entry))

    def crer(self, entry: ModelInSetting, corruption: str = AVERAGE) -> float:
        """Return CRE / clean EPE."""
        return self.cre(entry, corruption) / self.clean(entry)

    def family_crer(self, entry: ModelInSetting) -> dict[str, float]:
        """Return the mean CREr by family of corruptions."""
        return family_crer(self._cre[entry], self.clean(entry))

    def ood_id_pairs(self) -> list[tuple[ModelInSetting, ModelInSetting]]:
        """Return the (OOD, ID) pair of every supervised model that was measured in both settings."""
        ood = set(self.discussed("OOD", "supervised"))
        return [(("OOD", m), (s, m)) for s, m in self.discussed("ID", "supervised") if ("OOD", m) in ood]


@dataclass(frozen=True)
class Statement:
    """A statement of an observation.

    Attributes:
        claim: what the paper states; if `part` is "added", what it does not state.
        printed: whether its printed tables agree.
        numbers: the printed numbers that decide.
        margin: its interval over models, families or corruptions; None for a fact about named models.
        part: "main" if the verdict on the observation includes it.
    """

    claim: str
    printed: bool
    numbers: Mapping[str, float]
    margin: Margin | None = None
    part: Part = "also"

    @property
    def texts(self) -> tuple[str, str, str]:
        """The claim, "as printed" and "generalises", for a table."""
        numbers = "; ".join(f"{name} {value:.4g}" for name, value in self.numbers.items())
        margin = DASH if self.margin is None else f"{self.margin.verdict}: {self.margin}"
        return self.claim, f"{_word(self.printed)}: {numbers}", margin


@dataclass(frozen=True)
class Observation:
    """An observation from the paper; its verdicts are those of its main statements together."""

    number: int
    title: str
    parts: Sequence[Statement]

    @property
    def printed(self) -> bool:
        """Whether the printed tables agree."""
        return all(part.printed for part in self.parts if part.part == "main")

    @property
    def generalises(self) -> Verdict:
        """Whether it holds beyond the models and corruptions of the tables."""
        return joint(part.margin for part in self.parts if part.part == "main" and part.margin).verdict

    @property
    def heading(self) -> str:
        """The number, the title and the verdicts."""
        return f"{self.number}. {self.title}: as printed {_word(self.printed)}, generalises {self.generalises}"


def _word(printed: bool) -> str:
    return str(printed).lower()
