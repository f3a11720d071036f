"""The headline of a board: one sentence from its numbers, and one picture of the worst that happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...core.text import counted, first_of, joined, plain
from ...data.benchmarks.facts import is_still, sample_noun
from ...run.run import Run
from ...stats.attacks import attack_scores
from ...stats.model_result import ModelResult, by_frames
from ...stats.results import AVERAGE, CLEAN, LABELS, benchmark_words, inside, long_label
from ..leaderboard import GROUP
from ..table import Table, interval_text
from .content import Content
from .examples import PanelPicture, worst_strip

_MOST_NAMED = 3


@dataclass(frozen=True)
class Headline:
    """What the first screen of a board says and shows; the strip is (caption, address) of each part of a picture."""

    sentence: str
    strip: Sequence[tuple[str, str]] = ()
    panel: PanelPicture | None = None
    page: str = ""


def headline_of(content: Content, board: Table, panels: Mapping[ModelResult, Sequence[PanelPicture]]) -> Headline:
    """Return the headline of a board: about its run, its runs, or the values that have no run."""
    lines = [line.result for line in board.lines if line.result]
    runs = [line for line in lines if line.run]
    one = runs[0].run if len(runs) == 1 else None
    sentence = _about_run(runs[0], one) if one else _about_lines(content, board, lines)
    if sentence and is_still(board.name):
        sentence += " Zero flow is correct here, because nothing moves."
    elif sentence and all(("epe", CLEAN) not in line.values for line in lines):
        sentence += " A flow that is too short has a low RCRE."
    pictured = next((line for line in runs if line.run and panels.get(line)), None)
    if pictured is None or pictured.run is None:
        return Headline(sentence)
    panel = panels[pictured][0]
    return Headline(sentence, worst_strip(pictured.run), panel, content.pages[pictured])


def _about_run(line: ModelResult, run: Run) -> str:
    """State the error of a run on the clean frames and under corruption, and where it is largest."""
    measured = run.measured
    averaged = (line.beside_published and measured.paper_over) or measured.averaged_over
    with_truth = run.epe is not None or (run.rcre is None and run.epe_clean is not None)
    metric = "epe" if with_truth else "rcre"
    cells = [
        (value, f"{inside(long_label(of))} at severity {level}")
        for of in measured.averaged_over
        for level in measured.corruptions[of]
        if (value := run.mean(metric, of, level)) is not None
    ] or [
        (one[metric], f"the attack {one['attack']} at severity {one['severity']}")
        for one in attack_scores(run)
        if one[metric] is not None
    ]
    where = f"{counted(measured.samples, sample_noun(run.benchmark))} of {benchmark_words(run.benchmark)}"
    if not cells:
        return f"{plain(line.name)}: nothing could be measured on {where}."
    (value, most), clean, whole = max(cells), run.epe_clean if with_truth else None, line.number(metric, AVERAGE)
    over = {"on the clean frames": clean, f"under {counted(len(averaged), 'corruption')}": whole}
    means = " and ".join(f"{mean:.2f} px {condition}" for condition, mean in over.items() if mean is not None)
    head = f"{plain(line.name)}: {LABELS[metric]} {means}".rstrip()
    highest = f", highest for {most}: {value:.2f} px" if whole is None or value > whole else ""
    return f"{head} ({where}){highest}."


def _about_lines(content: Content, board: Table, lines: Sequence[ModelResult]) -> str:
    """State which result of the largest group on the same frames is the lowest, and which ones may be as low."""
    ranked = [line for line in lines if not line.excluded and (line.run or not any(one.run for one in lines))]
    metric = next((m for m in ("epe", "rcre") if any((m, AVERAGE) in line.values for line in ranked)), None)
    if metric is None:
        return ""
    groups = by_frames(line for line in ranked if (metric, AVERAGE) in line.values)
    known, where = max(groups.values(), key=len), benchmark_words(board.name)
    if len(groups) > 1 and len(known) == 1:
        return f"No two of the {len(groups)} ranked results on {where} are on the same frames, so none are compared."
    first, value = known[0], known[0].values[metric, AVERAGE]
    whose = f"{plain(first.name)} ({plain(first.setting, 40)})"
    number = f"{value.text} px {interval_text(value.ends)}".rstrip()
    if len(known) == 1:
        only = f"{whose} is the only ranked result on {where}"
        return f"{only}: its {LABELS[metric]} under corruption is {number}."
    lowest = f"{whose} has the lowest {LABELS[metric]} under corruption, {number}"
    same = "the same frames of " if len(groups) > 1 else ""
    of = f"Of {counted(len(known), 'ranked result')} on {same}{where}, "
    letters = {line: content.cells[line][GROUP].text for line in known if GROUP in content.cells[line]}
    if first not in letters:
        return f"{of}{lowest}; these differences are not tested."
    tested = [line for line in known[1:] if line in letters]
    all_tested = len(tested) == len(known) - 1
    tied = [plain(line.name) for line in tested if set(letters[line]) & set(letters[first])]
    if tied:
        names = first_of(tied, _MOST_NAMED) if len(tied) > _MOST_NAMED else joined(tied)
        only = "" if all_tested else f" (of the next {len(tested)}, the only ones tested)"
        return f"{of}{lowest}; {names} cannot be told apart from it{only}."
    others = "the others" if all_tested else f"the next {len(tested)}, the only ones tested"
    return f"{of}{lowest}; this is significantly lower than {others}."
