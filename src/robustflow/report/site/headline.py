"""First sentences of a page: the best model, and whether its lead is significant."""

from __future__ import annotations

from collections.abc import Sequence

from ...analysis.audit.rounding import misfits
from ...analysis.conclusion import conclusion, without_truth
from ...analysis.imported import NOTE as IMPORTED
from ...analysis.labels import METRIC_LABELS, benchmark_label, benchmark_words, on_benchmark
from ...analysis.model_result import ModelResult, ValueKey, not_ranked, ranked
from ...analysis.paper_means import paper_rows
from ...analysis.published.tables import PAPER
from ...analysis.results import AVERAGE, CLEAN
from ...analysis.still import PHANTOM, phantom_motion
from ...analysis.uncertainty import compare_leaders
from ...analysis.uncertainty.paired import MOST_COMPARED
from ...benchmarks.facts import is_still
from ...errors import RunError
from ...text import counted, joined, plain
from ..table import number_text
from .content import Content

_CLEAN: ValueKey = ("epe", CLEAN)
_MOVED: ValueKey = ("rcre", AVERAGE)
_PRINTED = 0.015
"""Largest combined error, in pixels, of three numbers rounded to hundredths."""
_RANKED: tuple[ValueKey, ...] = (("cre", AVERAGE), _MOVED)


def headline(content: Content, benchmark: str | None = None) -> list[str]:
    """Return sentences about the runs, followed by sentences about the paper's values, for one benchmark or all."""
    sentences: list[str] = []
    groups: dict[tuple[str, str], list[ModelResult]] = {}
    for line in content.lines:
        if benchmark in (None, line.benchmark):
            groups.setdefault((line.benchmark, line.frames), []).append(line)
    published = []
    imported = 0
    for (of, frames), lines in groups.items():
        if lines[0].note == IMPORTED:
            imported += len(lines)
        elif frames == PAPER:
            best = _best_of_settings(lines)
            published += [f"on {benchmark_words(of)} {best}"] if best else []
        elif own := [line for line in content.lines if line.frames == frames and line.run and without_truth(line.run)]:
            sentences.append(conclusion(own))
        elif is_still(of):
            sentences += [*_phantom(lines), PHANTOM]
        elif len(lines) == 1:
            reasons = [f"Not evidence of robustness: {reason}." for reason in not_ranked(lines)]
            sentences += _alone(lines[0]) + reasons
        else:
            sentences += _of_own(lines, content)
    if published and not content.alone:
        sentences.append(
            f"Among the published models, {'; '.join(published)}. The paper prints means but no values per image, so "
            "the significance of a lead is unknown."
        )
    if imported:
        sentences.append(
            f"Not ranked here: {counted(imported, 'imported line')}, because imported values cannot be verified."
        )
    return sentences


def _phantom(lines: Sequence[ModelResult]) -> list[str]:
    """State the phantom motion of each run in a group on static scenes."""
    known = [(line.name, phantom_motion(line.run)) for line in lines if line.run is not None]
    return [f"{plain(name)}: {sentence}." for name, sentence in known if sentence]


_LEAST = {"cre": "the error grows least", "rcre": "the flow changes least"}


def _best_of_settings(lines: Sequence[ModelResult]) -> str:
    """Name the model with the lowest CRE (RCRE if there is no CRE) for each setting, and explain the result."""
    leaders: dict[str, list[str]] = {}
    for setting in dict.fromkeys(line.setting for line in lines if line.setting != "knowledge"):
        if (leaders_of := _leaders([line for line in lines if line.setting == setting])) is not None:
            key, order = leaders_of
            leader = f"{plain(order[0].name)} ({plain(setting, 40)}, {METRIC_LABELS[key[0]]} {_printed(order[0], key)})"
            leaders.setdefault(_LEAST[key[0]], []).append(leader)
    return " and ".join(f"{least} under corruption for {joined(models)}" for least, models in leaders.items())


def _printed(line: ModelResult, key: ValueKey) -> str:
    """Format a printed score; if a CRE is inconsistent with the printed EPE, add the CRE recomputed from the EPE."""
    epe, clean, value = line.number("epe", AVERAGE), line.number("epe", CLEAN), line.values[key]
    text = f"{value.text} px"
    if key != ("cre", AVERAGE) or epe is None or clean is None or not misfits(value.number, epe - clean, _PRINTED):
        return text
    return f"{text} as printed, {epe - clean:.2f} px from its EPE"


def _alone(line: ModelResult) -> list[str]:
    where = on_benchmark(plain(line.name), line.benchmark)
    clean, whole, cre = (_text(line, key) for key in (_CLEAN, ("epe", AVERAGE), ("cre", AVERAGE)))
    if not clean or not whole:
        moved = _text(line, _MOVED)
        return [f"{where}: corruption changes its flow by {moved} px (RCRE)."] if moved else []
    if (line.run or line.coverage is not None) and cre and misfits(float(cre), float(whole) - float(clean), _PRINTED):
        up = "raises" if float(cre) > 0 else "lowers"
        changes = (
            f"{up} the end-point error over the pixels that have a flow on both the clean and the corrupted frames"
        )
    elif clean == whole:
        changes = f"leaves the end-point error unchanged at {clean} px"
    else:
        up = "raises" if float(whole) > float(clean) else "lowers"
        changes = f"{up} the end-point error from {clean} to {whole} px"
    sentence = (
        f"{where}: corruption {changes} "
        f"(CRE {cre or '–'} px, CREr {'–' if line.crer is None else number_text(line.crer)})"
    )
    interval = line.intervals.get(("cre", AVERAGE))
    if interval is None:
        return [f"{sentence}. There are too few images or values for a confidence interval."]
    significant = "significant" if interval[0] > 0 or interval[1] < 0 else "not significant"
    return [f"{sentence}; 95 % interval of the CRE {interval[0]:.2f} to {interval[1]:.2f} px: {significant}."]


def _of_own(lines: Sequence[ModelResult], content: Content) -> list[str]:
    """Return sentences about the ranked model whose error increases least, whether its lead is significant, and which
    model is most accurate."""
    reasons = not_ranked(lines)
    left_out = [f"Not ranked: {'; '.join(reasons)}."] if reasons else []
    sound = ranked(lines)
    leaders = _leaders(sound)
    if leaders is None:
        return [sentence for line in sound for sentence in _alone(line)] + left_out
    key, order = leaders
    best, second = order[0], order[1]
    start = f"{benchmark_label(best.benchmark)}, {len(sound)} models on the same frames: "
    tied = [plain(line.name) for line in order if line.values[key].number == best.values[key].number]
    if len(tied) > 1:
        shared = f"{METRIC_LABELS[key[0]]} {best.values[key].text} px"
        return [f"{start}{joined(tied)} share the lead ({shared}).", *left_out]
    sure, evidence = _difference(key[0], order, content)
    first, other = (f"{plain(line.name)} ({_shown(line, key)})" for line in (best, second))
    if sure:
        sentence = f"{start}{_LEAST[key[0]]} under corruption for {first}, followed by {other}"
    else:
        sentence = f"{start}none can be called the most robust: the lead of {first} over {other} may be due to chance"
    moved, less = (line.number(*_MOVED) for line in (best, second))
    if key != _MOVED and moved is not None and less is not None and moved - less >= 0.005:
        sentence += f"; the flow of {plain(second.name)} changes less (RCRE {less:.2f} against {moved:.2f} px)"
    sentence += "."
    known = [line for line in order if _CLEAN in line.values]
    accurate = min(known, key=lambda line: line.values[_CLEAN].number, default=best)
    if _CLEAN in best.values and accurate.values[_CLEAN].number < best.values[_CLEAN].number:
        sentence += f" The most accurate is {plain(accurate.name)} ({_shown(accurate, key)})."
    return [sentence, *evidence, *left_out]


def _shown(line: ModelResult, key: ValueKey) -> str:
    """State a score together with the clean EPE and the share of predicted pixels, which are needed to interpret it."""
    clean = _text(line, _CLEAN)
    text = f"{METRIC_LABELS[key[0]]} {line.values[key].text} px" + (f"; clean EPE {clean} px" if clean else "")
    return text if line.coverage is None else f"{text}; on {100 * line.coverage:.1f} % of the pixels"


def _text(line: ModelResult, key: ValueKey) -> str:
    return line.values[key].text if key in line.values else ""


def _difference(metric: str, order: Sequence[ModelResult], content: Content) -> tuple[bool, list[str]]:
    """Return whether the lead of the best model over the second-best is significant, with a sentence about it."""
    rows = paper_rows if content.of_paper else (lambda run: run.rows)
    measured = {line.name: rows(line.run) for line in order[:MOST_COMPARED] if line.run is not None}
    if len(measured) < min(len(order), MOST_COMPARED):
        return False, []  # results files have no values per image
    try:
        pair = compare_leaders(measured, metric)
    except RunError:
        return False, []  # records may group the same samples differently; the leaderboard still shows their values
    if pair is None:
        return False, []
    return pair["p_holm"] is not None and pair["p_holm"] < 0.05, [plain(pair["sentence"], None)]


def _leaders(lines: Sequence[ModelResult]) -> tuple[ValueKey, list[ModelResult]] | None:
    for key in _RANKED:
        known = [line for line in lines if key in line.values]
        if len(known) > 1:
            return key, sorted(known, key=lambda line: (line.values[key].number, plain(line.name)))
    return None
