"""The numbers of a page as data, for its download buttons: compact, one line per model and metric."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...analysis.results import AVERAGE, CLEAN, METRICS
from ...corruptions.registry import FAMILIES, PAPER_ORDER
from ...text import plain
from .entries import Entry


def download_data(entries: Sequence[Entry]) -> dict[str, Any]:
    """Columns and lines: benchmark, setting, model, metric, sample set, note, then the printed number of each column.

    Means over classes of corruptions are not among them: they follow from the rest.
    """
    found = {corruption for entry in entries for _, corruption in entry.texts} - {"", *FAMILIES}
    known = (CLEAN, AVERAGE, *PAPER_ORDER)
    corruptions = [name for name in known if name in found] + sorted(found - set(known))
    lines = []
    for entry in entries:
        head = [entry.benchmark, entry.setting, entry.model]
        for metric in METRICS:
            values = [entry.texts.get((metric, corruption)) for corruption in corruptions]
            if any(values):
                lines.append([*map(plain, head), metric, plain(entry.sample_set, 200), entry.note, *values])
    return {"corruptions": list(map(plain, corruptions)), "lines": lines}
