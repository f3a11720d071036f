"""The paper's variants: a method in a setting, with the corresponding model of this package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..analysis.published.tables import published_results
from ..errors import UsageError, unknown_name
from ..models.catalog import methods

_RUN_AS = {"DIS": "dis_rgb"}
"""Methods whose name in the paper refers to a different model in this package: the paper ran the authors' DIS on colour
images (docs/dis-rgb.md)."""


@dataclass(frozen=True)
class Variant:
    """A method from the paper in one setting."""

    method: str
    setting: str
    model: str

    @property
    def slug(self) -> str:
        """Return the file name of the variant's weights in a checkpoint folder, without the extension."""
        return self.model if self.setting == "knowledge" else f"{self.model}-{self.setting.lower()}"


def paper_variants(benchmark: str, wanted: Sequence[str] | None = None) -> list[Variant]:
    """Return the variants with published values on a benchmark, in the paper's order."""
    lines = [line for line in published_results() if line.benchmark == benchmark]
    known = {entry.method: name for name, entry in methods().items()} | _RUN_AS
    every = [Variant(line.name, line.setting, known[line.name]) for line in lines]
    if wanted is None:
        return every
    chosen: dict[str, str] = {}
    for name in wanted:
        method, model = _named(name, every)
        if chosen.get(method, model) != model:
            raise UsageError(
                f"{method} can be run as only one model at a time; choose either {chosen[method]} or {model}"
            )
        chosen[method] = model
    return [Variant(v.method, v.setting, chosen[v.method]) for v in every if v.method in chosen]


def _named(name: str, every: Sequence[Variant]) -> tuple[str, str]:
    """Return the paper's name and the model to run."""
    entry = methods().get(name)
    for variant in every:
        if name in (variant.method, variant.model) or (entry is not None and entry.method == variant.method):
            return variant.method, name if entry is not None else variant.model
    raise unknown_name("published model", name, dict.fromkeys(variant.model for variant in every))
