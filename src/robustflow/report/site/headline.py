"""The first sentences of a page: who is best, and whether that is significant."""

from __future__ import annotations

from collections.abc import Sequence

from ...errors import RunError
from ..labels import BENCHMARK_LABELS, METRIC_LABELS
from ..published import PAPER
from ..results import AVERAGE, CLEAN
from ..text import plain
from ..uncertainty import compare
from .content import Content
from .entries import Entry, Key

_RANKED: tuple[Key, ...] = (("cre", AVERAGE), ("rcre", AVERAGE))


def headline(content: Content) -> list[str]:
    """Sentences about the runs first, then about the paper's values."""
    sentences: list[str] = []
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in content.entries:
        groups.setdefault((entry.benchmark, entry.sample_set), []).append(entry)
    for (_, frames), entries in sorted(groups.items(), key=lambda item: item[0][1] == PAPER):
        if frames == PAPER:
            if not content.alone:
                sentences += _published(entries)
        elif len(entries) == 1:
            sentences += _alone(entries[0])
        else:
            sentences += _of_own(entries, content)
    return sentences


def _published(entries: list[Entry]) -> list[str]:
    """Per setting the lowest CRE; the paper gives no value per image, so no test can be made."""
    told = []
    for setting in dict.fromkeys(entry.setting for entry in entries):
        found = _ranked([entry for entry in entries if entry.setting == setting and entry.setting != "knowledge"])
        if found is not None:
            key, order = found
            told.append(f"{order[0].model} {plain(setting, 40)} ({METRIC_LABELS[key[0]]} {order[0].texts[key]} px)")
    if not told:
        return []
    return [
        f"Published, {_label(entries[0])}: lowest {' and '.join(told)}. The paper prints means without values per "
        "image, so whether a lead is more than chance cannot be told."
    ]


def _alone(entry: Entry) -> list[str]:
    clean, whole = entry.texts.get(("epe", CLEAN)), entry.texts.get(("epe", AVERAGE))
    if clean is None or whole is None:
        moved = entry.texts.get(("rcre", AVERAGE))
        return [f"{entry.model}, {_label(entry)}: corruption moves its flow by {moved} px (RCRE)."] if moved else []
    sentence = (
        f"{entry.model}, {_label(entry)}: corruption raises the end-point error from {clean} to {whole} px "
        f"(CRE {entry.texts.get(('cre', AVERAGE), '–')} px, CREr {entry.texts.get(('crer', AVERAGE), '–')})"
    )
    interval = entry.intervals.get(("cre", AVERAGE))
    if interval is None:
        return [f"{sentence}. Too few images for a confidence interval."]
    significant = "more than chance" if interval[0] > 0 or interval[1] < 0 else "not more than chance"
    return [f"{sentence}; 95 % interval of the CRE {interval[0]:.2f} to {interval[1]:.2f} px: {significant}."]


def _of_own(entries: list[Entry], content: Content) -> list[str]:
    found = _ranked(entries)
    if found is None:
        return []
    key, order = found
    best, second = order[0], order[1]
    sentences = [
        f"{_label(best)}, {len(entries)} models on the same frames: {best.model} has the lowest "
        f"{METRIC_LABELS[key[0]]} ({best.texts[key]} px), before {second.model} ({second.texts[key]} px)."
    ]
    runs = [content.runs.get((entry.sample_set, entry.name)) for entry in (best, second)]
    if runs[0] is None or runs[1] is None:
        return sentences
    try:
        table = compare(runs[0].rows, runs[1].rows, (best.model, second.model)).filter(
            metric=key[0], corruption=AVERAGE
        )
    except RunError:
        return sentences
    return sentences + [plain(sentence, None) for sentence in table["sentence"]]


def _ranked(entries: Sequence[Entry]) -> tuple[Key, list[Entry]] | None:
    for key in _RANKED:
        known = [entry for entry in entries if key in entry.numbers]
        if len(known) > 1:
            return key, sorted(known, key=lambda entry: (entry.numbers[key], entry.model))
    return None


def _label(entry: Entry) -> str:
    return BENCHMARK_LABELS.get(entry.benchmark, plain(entry.benchmark))
