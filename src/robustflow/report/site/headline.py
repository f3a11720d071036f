"""The first sentences of a page: which model is best, and whether that is significant."""

from __future__ import annotations

from collections.abc import Sequence

from ...analysis.audit.rounding import misfits
from ...analysis.conclusion import conclusion, without_truth
from ...analysis.imported import NOTE as IMPORTED
from ...analysis.labels import METRIC_LABELS, benchmark_label, benchmark_words, on_benchmark
from ...analysis.paper_means import paper_rows
from ...analysis.published.tables import PAPER
from ...analysis.results import AVERAGE, CLEAN
from ...analysis.still import PHANTOM, phantom_motion
from ...analysis.uncertainty import compare_all
from ...benchmarks.facts import is_still
from ...errors import RunError
from ...text import counted, joined, plain
from .content import Content
from .entries import LeaderboardEntry, NumberKey

MOST_COMPARED = 8
_CLEAN: NumberKey = ("epe", CLEAN)
_MOVED: NumberKey = ("rcre", AVERAGE)
_RANKED: tuple[NumberKey, ...] = (("cre", AVERAGE), _MOVED)


def headline(content: Content, benchmark: str | None = None) -> list[str]:
    """Sentences about the runs first, then about the paper's values; of one benchmark, or of all."""
    sentences: list[str] = []
    groups: dict[tuple[str, str], list[LeaderboardEntry]] = {}
    for entry in content.entries:
        if benchmark in (None, entry.line.benchmark):
            groups.setdefault((entry.line.benchmark, entry.line.frames), []).append(entry)
    published = []
    imported = 0
    for (of, frames), entries in groups.items():
        if entries[0].note == IMPORTED:
            imported += len(entries)
        elif frames == PAPER:
            best = _best_of_settings(entries)
            published += [f"on {benchmark_words(of)} {best}"] if best else []
        elif own := [line for line in content.lines if line.frames == frames and line.run and without_truth(line.run)]:
            sentences.append(conclusion(own))
        elif is_still(of):
            sentences += [*_phantom(entries), PHANTOM]
        elif len(entries) == 1:
            sentences += _alone(entries[0]) + _not_ranked(entries, "No sign of robustness")
        else:
            sentences += _of_own(entries, content)
    if published and not content.alone:
        sentences.append(
            f"Among the published models, {'; '.join(published)}. The paper prints means but no values per image, so "
            "it is unknown whether a lead is more than chance."
        )
    if imported:
        sentences.append(f"Not judged here: {counted(imported, 'imported line')}, in which nothing can be verified.")
    return sentences


def _phantom(entries: Sequence[LeaderboardEntry]) -> list[str]:
    """The phantom motion of each run of a group over still scenes."""
    known = {entry.model: phantom_motion(entry.line.run) for entry in entries if entry.line.run is not None}
    return [f"{model}: {sentence}." for model, sentence in known.items() if sentence]


_LEAST = {"cre": "the error grows least", "rcre": "the flow changes least"}


def _best_of_settings(entries: list[LeaderboardEntry]) -> str:
    """For each setting the model with the lowest CRE, or RCRE if there is no CRE, and what that means."""
    leaders: dict[str, list[str]] = {}
    for setting in dict.fromkeys(entry.setting for entry in entries if entry.setting != "knowledge"):
        ranked = _ranked([entry for entry in entries if entry.setting == setting])
        if ranked is not None:
            key, order = ranked
            leader = f"{order[0].model} ({setting}, {METRIC_LABELS[key[0]]} {_printed(order[0], key)})"
            leaders.setdefault(_LEAST[key[0]], []).append(leader)
    return " and ".join(f"{least} under corruption for {joined(models)}" for least, models in leaders.items())


def _printed(entry: LeaderboardEntry, key: NumberKey) -> str:
    """A printed score; for a CRE that does not follow from the printed EPE, also the one that does."""
    epe, clean = (entry.numbers.get(("epe", name)) for name in (AVERAGE, CLEAN))
    text = f"{entry.texts[key]} px"
    if key != ("cre", AVERAGE) or epe is None or clean is None or not misfits(entry.numbers[key], epe - clean, 0.015):
        return text
    return f"{text} as printed, {epe - clean:.2f} px from its EPE"


def _alone(entry: LeaderboardEntry) -> list[str]:
    where = on_benchmark(entry.model, entry.line.benchmark)
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


def _of_own(entries: list[LeaderboardEntry], content: Content) -> list[str]:
    """Which error grows least, if that is more than chance, and the accuracy; among the models that are ranked."""
    left_out = _not_ranked(entries, "Not ranked")
    sound = [entry for entry in entries if not entry.line.excluded]
    ranked = _ranked(sound)
    if ranked is None:
        return [sentence for entry in sound for sentence in _alone(entry)] + left_out
    key, order = ranked
    best, second = order[0], order[1]
    start = f"{benchmark_label(best.line.benchmark)}, {len(sound)} models on the same frames: "
    if best.numbers[key] == second.numbers[key]:
        return [f"{start}{best.model} and {second.model} share the lead ({_shown(best, key)}).", *left_out]
    sure, evidence = _difference(key[0], order, content)
    first, other = (f"{entry.model} ({_shown(entry, key)})" for entry in (best, second))
    if sure:
        sentence = f"{start}{_LEAST[key[0]]} under corruption for {first}, before {other}"
    else:
        sentence = f"{start}none can be called the most robust: the lead of {first} over {other} may be chance"
    moved, less = (entry.numbers.get(_MOVED) for entry in (best, second))
    if key != _MOVED and moved is not None and less is not None and moved - less >= 0.005:
        sentence += f"; the flow of {second.model} changes less (RCRE {less:.2f} against {moved:.2f} px)"
    sentence += "."
    accurate = min(order, key=lambda entry: entry.numbers.get(_CLEAN, float("inf")))
    if accurate.numbers.get(_CLEAN, float("inf")) < best.numbers.get(_CLEAN, 0.0):
        sentence += f" The most accurate is {accurate.model} ({_shown(accurate, key)})."
    return [sentence, *evidence, *left_out]


def _shown(entry: LeaderboardEntry, key: NumberKey) -> str:
    """A score together with the accuracy, without which it cannot be judged."""
    clean = entry.texts.get(_CLEAN)
    return f"{METRIC_LABELS[key[0]]} {entry.texts[key]} px" + (f"; clean EPE {clean} px" if clean else "")


def _not_ranked(entries: Sequence[LeaderboardEntry], start: str) -> list[str]:
    """Which models are not called robust, and why."""
    reasons = [f"{entry.model}, because {entry.line.excluded}" for entry in entries if entry.line.excluded]
    return [f"{start}: {'; '.join(reasons)}."] if reasons else []


def _difference(metric: str, order: Sequence[LeaderboardEntry], content: Content) -> tuple[bool, list[str]]:
    """Whether the best leads the second by more than chance, and the sentence about it; corrected for every pair of the
    best `MOST_COMPARED`, because the two were chosen by looking at all."""
    lines = [entry.line for entry in order[:MOST_COMPARED]]
    rows = paper_rows if content.of_paper else (lambda run: run.rows)
    measured = {line.name: rows(line.run) for line in lines if line.run is not None}
    if len(measured) < len(lines):
        return False, []  # Results files have no values per image.
    try:
        table = compare_all(measured, metric)
    except RunError:
        return False, []  # Records may group the same samples differently; the leaderboard still shows their values.
    pair = table.filter(first=order[0].line.name, second=order[1].line.name)
    sure = any(p is not None and p < 0.05 for p in pair["p_holm"])
    return sure, [plain(sentence, None) for sentence in pair["sentence"]]


def _ranked(entries: Sequence[LeaderboardEntry]) -> tuple[NumberKey, list[LeaderboardEntry]] | None:
    for key in _RANKED:
        known = [entry for entry in entries if key in entry.numbers]
        if len(known) > 1:
            return key, sorted(known, key=lambda entry: (entry.numbers[key], entry.model))
    return None
