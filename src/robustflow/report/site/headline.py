"""The first sentences of a page: who is best, and whether that is significant."""

from __future__ import annotations

from collections.abc import Sequence

from ...analysis.labels import METRIC_LABELS, benchmark_label
from ...analysis.published.tables import PAPER
from ...analysis.results import AVERAGE, CLEAN
from ...analysis.uncertainty import compare_all
from ...errors import RunError
from ...text import plain
from .content import Content
from .entries import Entry, Key

MOST_COMPARED = 8
_RANKED: tuple[Key, ...] = (("cre", AVERAGE), ("rcre", AVERAGE))


def headline(content: Content) -> list[str]:
    """Sentences about the runs first, then about the paper's values."""
    sentences: list[str] = []
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in content.entries:
        groups.setdefault((entry.benchmark, entry.sample_set), []).append(entry)
    published = []
    for (benchmark, frames), entries in groups.items():
        if frames == PAPER:
            published += [f"on {benchmark_label(benchmark)} {best}" for best in _best_of_settings(entries)]
        elif len(entries) == 1:
            sentences += _alone(entries[0])
        else:
            sentences += _of_own(entries, content)
    if published and not content.alone:
        sentences.append(
            f"Of the published models the most robust are {', '.join(published)}. The paper prints means and no values "
            "per image, so whether a lead is more than chance cannot be told."
        )
    return sentences


def _best_of_settings(entries: list[Entry]) -> list[str]:
    """Per setting the model with the lowest CRE, or RCRE where there is none."""
    told = []
    for setting in dict.fromkeys(entry.setting for entry in entries if entry.setting != "knowledge"):
        found = _ranked([entry for entry in entries if entry.setting == setting])
        if found is not None:
            key, order = found
            told.append(f"{order[0].model} ({setting}, {METRIC_LABELS[key[0]]} {order[0].texts[key]} px)")
    return told


def _alone(entry: Entry) -> list[str]:
    where = f"{entry.model} on {benchmark_label(entry.benchmark)}"
    clean, whole = entry.texts.get(("epe", CLEAN)), entry.texts.get(("epe", AVERAGE))
    if clean is None or whole is None:
        moved = entry.texts.get(("rcre", AVERAGE))
        return [f"{where}: corruption moves its flow by {moved} px (RCRE)."] if moved else []
    changes = (
        f"leaves the end-point error at {clean} px"
        if clean == whole
        else f"{'raises' if float(whole) > float(clean) else 'lowers'} the end-point error from {clean} to {whole} px"
    )
    sentence = (
        f"{where}: corruption {changes} "
        f"(CRE {entry.texts.get(('cre', AVERAGE), '–')} px, CREr {entry.texts.get(('crer', AVERAGE), '–')})"
    )
    interval = entry.intervals.get(("cre", AVERAGE))
    if interval is None:
        return [f"{sentence}. Too few images, or values, for a confidence interval."]
    significant = "more than chance" if interval[0] > 0 or interval[1] < 0 else "not more than chance"
    return [f"{sentence}; 95 % interval of the CRE {interval[0]:.2f} to {interval[1]:.2f} px: {significant}."]


def _of_own(entries: list[Entry], content: Content) -> list[str]:
    found = _ranked(entries)
    if found is None:
        return []
    key, order = found
    best, second = order[0], order[1]
    metric = METRIC_LABELS[key[0]]
    start = f"{benchmark_label(best.benchmark)}, {len(entries)} models on the same frames: "
    if best.numbers[key] == second.numbers[key]:
        return [f"{start}{best.model} and {second.model} have the same lowest {metric} ({best.texts[key]} px)."]
    sentences = [
        f"{start}{best.model} has the lowest {metric} ({best.texts[key]} px), before {second.model} "
        f"({second.texts[key]} px)."
    ]
    return sentences + _difference(key[0], order, content)


def _difference(metric: str, order: Sequence[Entry], content: Content) -> list[str]:
    """Whether the best differs from the second, corrected for every pair of the best `MOST_COMPARED`: which two are
    compared was chosen by looking at all."""
    runs = {entry.name: content.runs.get((entry.sample_set, entry.name)) for entry in order[:MOST_COMPARED]}
    measured = {name: run.rows for name, run in runs.items() if run is not None}
    if len(measured) < len(runs):
        return []  # Results files have no values per image.
    try:
        table = compare_all(measured, metric)
    except RunError:
        return []  # Frames differ under the same names; the leaderboard still says what each run measured.
    pair = table.filter(first=order[0].name, second=order[1].name)
    return [plain(sentence, None) for sentence in pair["sentence"]]


def _ranked(entries: Sequence[Entry]) -> tuple[Key, list[Entry]] | None:
    for key in _RANKED:
        known = [entry for entry in entries if key in entry.numbers]
        if len(known) > 1:
            return key, sorted(known, key=lambda entry: (entry.numbers[key], entry.model))
    return None
