"""First sentences of a page: the best model, and whether its lead is significant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ...core.errors import RunError
from ...core.text import counted, joined, plain
from ...data.benchmarks.facts import is_still
from ...stats.audit.findings import misfits
from ...stats.conclusion import conclusion
from ...stats.exclusion import PHANTOM, phantom_motion
from ...stats.model_result import ModelResult, ValueKey, not_ranked, ranked
from ...stats.paper_means import paper_rows
from ...stats.published.tables import PAPER
from ...stats.results import AVERAGE, CLEAN, METRIC_LABELS, benchmark_label, benchmark_words, on_benchmark
from ...stats.uncertainty import compare_leaders, compare_rows
from ...stats.uncertainty.paired import MOST_COMPARED
from ..table import number_text
from .content import Content

_CLEAN: ValueKey = ("epe", CLEAN)
_EPE: ValueKey = ("epe", AVERAGE)
_CRE: ValueKey = ("cre", AVERAGE)
_MOVED: ValueKey = ("rcre", AVERAGE)
_PRINTED = 0.015
"""Largest combined error, in pixels, of three numbers rounded to hundredths."""


def headline(content: Content, benchmark: str | None = None) -> list[str]:
    """Return sentences about the runs, followed by sentences about the paper's values, for one benchmark or all."""
    sentences: list[str] = []
    groups: dict[tuple[str, str], list[ModelResult]] = {}
    for line in content.lines:
        if benchmark in (None, line.benchmark):
            groups.setdefault((line.benchmark, line.frames), []).append(line)
    published = []
    claimed = 0
    for (of, frames), lines in groups.items():
        if lines[0].source == "claimed":
            claimed += len(lines)
        elif frames == PAPER:
            best = _best_of_settings(lines)
            published += [f"on {benchmark_words(of)} {best}"] if best else []
        elif all(_CLEAN not in line.values and _MOVED in line.values for line in lines):
            sentences.append(conclusion(lines))
        elif is_still(of):
            sentences += [*_phantom_motion_sentences(lines), PHANTOM]
        elif len(lines) == 1:
            reasons = [f"Not evidence of robustness: {reason}." for reason in not_ranked(lines)]
            sentences += _single_model(lines[0]) + reasons
        else:
            sentences += _measured_models(lines, content)
    if published and not content.alone:
        sentences.append(
            f"Among the published models, {'; '.join(published)}. The paper prints means but no values per image, so "
            "the significance of a lead is unknown."
        )
    if claimed:
        sentences.append(
            f"Not ranked here: {counted(claimed, 'claimed line')}, because values without rows cannot be verified."
        )
    return sentences


def _phantom_motion_sentences(lines: Sequence[ModelResult]) -> list[str]:
    """State the phantom motion of each run in a group on static scenes."""
    known = [(line.name, phantom_motion(line.run)) for line in lines if line.run is not None]
    return [f"{plain(name)}: {sentence}." for name, sentence in known if sentence]


def _best_of_settings(lines: Sequence[ModelResult]) -> str:
    """Name the model with the lowest EPE (RCRE without ground truth) under corruption for each setting."""
    leaders: dict[str, list[str]] = {}
    for setting in dict.fromkeys(line.setting for line in lines if line.setting != "knowledge"):
        for key, what in ((_EPE, "the error under corruption is lowest"), (_MOVED, "the flow changes least")):
            if len(order := _in_order((line for line in lines if line.setting == setting), key)) > 1:
                best = order[0]
                leader = (
                    f"{plain(best.name)} ({plain(setting, 40)}, {METRIC_LABELS[key[0]]} {best.values[key].text} px)"
                )
                leaders.setdefault(what, []).append(leader)
                break
    return " and ".join(f"{what} for {joined(models)}" for what, models in leaders.items())


def _in_order(lines: Iterable[ModelResult], key: ValueKey) -> list[ModelResult]:
    known = [line for line in lines if key in line.values]
    return sorted(known, key=lambda line: (line.values[key].number, plain(line.name)))


def _single_model(line: ModelResult) -> list[str]:
    where = on_benchmark(plain(line.name), line.benchmark)
    clean, whole, cre = (_text(line, key) for key in (_CLEAN, _EPE, _CRE))
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
    interval = line.intervals.get(_CRE)
    if interval is None:
        return [f"{sentence}. There are too few images or values for a confidence interval."]
    significant = "significant" if interval[0] > 0 or interval[1] < 0 else "not significant"
    return [f"{sentence}; 95 % interval of the CRE {interval[0]:.2f} to {interval[1]:.2f} px: {significant}."]


def _measured_models(lines: Sequence[ModelResult], content: Content) -> list[str]:
    """Return sentences about the ranked models. The most robust one has a significantly lower EPE under corruption than
    the second, and no other is significantly more accurate on the clean frames: a flow that is too short has a low CRE
    and RCRE, so these only explain an error."""
    reasons = not_ranked(lines)
    left_out = [f"Not ranked: {'; '.join(reasons)}."] if reasons else []
    sound = ranked(lines)
    order = _in_order(sound, _EPE)
    if len(order) < 2:
        return [sentence for line in sound for sentence in _single_model(line)] + left_out
    best, second = order[:2]
    start = f"{benchmark_label(best.benchmark)}, {len(sound)} models on the same frames: "
    tied = [plain(line.name) for line in order if line.values[_EPE].number == best.values[_EPE].number]
    if len(tied) > 1:
        return [
            f"{start}{joined(tied)} share the lowest EPE under corruption ({best.values[_EPE].text} px).",
            *left_out,
        ]
    sure, evidence = _lead(order, content)
    accurate = next((line for line in _in_order(order, _CLEAN) if _is_more_accurate(line, best)), None)
    if not sure:
        lead = f"the lead of {_scored(best)} over {_scored(second)}"
        verdict = f"none can be called the most robust: {lead} may be due to chance"
    elif accurate is not None:
        verdict = (
            f"none can be called the most robust: {_scored(best)} has the lowest error under corruption, and "
            f"{_scored(accurate)} a lower one on the clean frames"
        )
    else:
        verdict = f"the most robust is {_scored(best)}, followed by {_scored(second)}"
    return [f"{start}{verdict}.", *evidence, *left_out]


def _scored(line: ModelResult) -> str:
    """Name a model with its errors and the share of predicted pixels, which are needed to interpret them."""
    keys = ((_EPE, "EPE"), (_CLEAN, "clean EPE"), (_CRE, "CRE"))
    texts = [f"{label} {line.values[key].text} px" for key, label in keys if key in line.values]
    texts += [] if line.coverage is None else [f"on {100 * line.coverage:.1f} % of the pixels"]
    return f"{plain(line.name)} ({'; '.join(texts)})"


def _text(line: ModelResult, key: ValueKey) -> str:
    return line.values[key].text if key in line.values else ""


def _lead(order: Sequence[ModelResult], content: Content) -> tuple[bool, list[str]]:
    """Return whether the EPE of the first model is significantly lower than that of the second, with a sentence about
    it."""
    rows = paper_rows if content.of_paper else (lambda run: run.rows)
    measured = {line.name: rows(line.run) for line in order[:MOST_COMPARED] if line.run is not None}
    try:
        pair = compare_leaders(measured, "epe")
    except RunError:
        return False, []  # records may group the same samples differently; the leaderboard still shows their values
    if pair is None:
        return False, []
    return pair["p_holm"] is not None and pair["p_holm"] < 0.05, [plain(pair["sentence"], None)]


def _is_more_accurate(line: ModelResult, best: ModelResult) -> bool:
    """Return whether the clean EPE of a model is significantly lower than that of the best one under corruption."""
    least = best.number(*_CLEAN)
    if line.run is None or best.run is None or least is None or line.values[_CLEAN].number >= least:
        return False
    first, second = (run.rows.filter(corruption=CLEAN) for run in (line.run, best.run))
    try:
        (p,) = compare_rows(first, second)["p_holm"]
    except RunError:
        return True
    return p is not None and p < 0.05
