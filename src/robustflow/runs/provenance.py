"""Describe a model's training data, and what they mean for a run."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ..benchmarks.setting import BACKBONE_NOTE, PAIRS_NOTE, judge
from ..models.provenance import KNOWLEDGE, RANDOM, Setting, Training
from ..validated import Untrusted
from .identity import Text


class Provenance(Untrusted):
    """The training data of a model."""

    setting: Setting
    trained_on: Annotated[tuple[Text, ...], Field(max_length=100)] | None
    basis: Text
    note: str = ""
    backbone: Text | Literal[""] = ""

    @classmethod
    def of(
        cls,
        training: Training,
        benchmark: str,
        keys: Collection[str] | None = None,
        protocol: Mapping[str, Any] | None = None,
    ) -> Provenance:
        """Return the provenance of a model on a benchmark; arguments as for `setting_of`."""
        setting, notes = judge(training, benchmark, keys, protocol or {})
        note = "; ".join(filter(None, (training.note, *notes)))
        backbone = training.backbone
        return cls(setting=setting, trained_on=training.sets, basis=training.basis, note=note, backbone=backbone)

    def on(self, benchmark: str, keys: Collection[str], protocol: Mapping[str, Any]) -> Provenance:
        """Return the provenance of the same training data for a benchmark and the given samples."""
        own = "; ".join(part for part in self.note.split("; ") if not part.startswith((PAIRS_NOTE, BACKBONE_NOTE)))
        trained = self.basis not in (RANDOM, KNOWLEDGE)
        training = Training(self.trained_on, self.basis, own, trained=trained, backbone=self.backbone)
        return Provenance.of(training, benchmark, keys, protocol)


UNDECLARED = Provenance(setting="UNKNOWN", trained_on=None, basis="undeclared")
"""The provenance of a model with unknown training data."""
