"""The paper's variants: a method in a setting, and the model that it is here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..analysis.published.tables import published_results
from ..errors import UsageError, unknown_name
from ..models.catalog import methods

_RUN_AS = {"DIS": "dis_rgb"}
"""Names of the paper that mean a different model here: it ran the authors' DIS on colours (docs/dis-rgb.md)."""


@dataclass(frozen=True)
class Variant:
    """A method of the paper in a setting.

    Attributes:
        method: as the paper calls it.
        setting: "knowledge", "OOD" or "ID".
        model: the registered model that it is run as.
    """

    method: str
    setting: str
    model: str

    @property
    def slug(self) -> str:
        """What its weights are called in a folder of checkpoints, without the ending.

        >>> Variant("FlowFormer++", "OOD", "flowformer_pp").slug
        'flowformer_pp-ood'
        """
        return self.model if self.setting == "knowledge" else f"{self.model}-{self.setting.lower()}"


def paper_variants(benchmark: str, wanted: Sequence[str] | None = None) -> list[Variant]:
    """The variants that the paper has values of on a benchmark, in its order.

    Args:
        benchmark: "kitti-fc" or "gopro-fc".
        wanted: only these, by the paper's names ("RAFT") or registered ones ("raft"). `dis` is OpenCV's, in place of
            the RGB version that the paper ran.

    Raises:
        UsageError: a wanted model that the paper has no values of.

    >>> len(paper_variants("kitti-fc")), len(paper_variants("gopro-fc"))
    (29, 11)
    >>> [variant.model for variant in paper_variants("kitti-fc", ["dis", "RAFT"])]
    ['dis', 'raft', 'raft']
    """
    lines = [line for line in published_results() if line.benchmark == benchmark]
    known = {entry.method: name for name, entry in methods().items()} | _RUN_AS
    every = [Variant(line.name, line.setting, known[line.name]) for line in lines]
    if wanted is None:
        return every
    chosen: dict[str, str] = {}
    for name in wanted:
        method, model = _named(name, every)
        if chosen.get(method, model) != model:
            raise UsageError(f"{method} can be run as one model at a time; name one of {chosen[method]} and {model}")
        chosen[method] = model
    return [Variant(v.method, v.setting, chosen[v.method]) for v in every if v.method in chosen]


def _named(name: str, every: Sequence[Variant]) -> tuple[str, str]:
    """The paper's name, and the model that is run."""
    entry = methods().get(name)
    for variant in every:
        if name in (variant.method, variant.model) or (entry is not None and entry.method == variant.method):
            return variant.method, name if entry is not None else variant.model
    raise unknown_name("model of the paper's", name, dict.fromkeys(variant.model for variant in every))
