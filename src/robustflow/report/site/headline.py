"""The headline of a board: one sentence from its numbers, and one picture of the worst that happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ...core.text import counted, plain
from ...data.benchmarks.facts import is_still, sample_noun
from ...metrics.measures import MEASURES
from ...run.run import Run
from ...stats.attacks import attack_scores
from ...stats.estimate import contrast, cubes_of
from ...stats.intervals import paper_rows
from ...stats.model_result import ModelResult, by_frames
from ...stats.paired import difference_sentence
from ...stats.results import AVERAGE, CLEAN, LABELS, benchmark_words, inside, long_label
from ..leaderboard import Setting, setting_of
from ..table import Table, interval_text
from .content import Content
from .examples import PanelPicture


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
    panel = replace(panel, title=f"{plain(pictured.name)}. {panel.title}")
    return Headline(sentence, [panel.tiles[place] for place in panel.shown], panel, content.pages[pictured])


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
    """State the verdict on the largest group of results of one setting on the same frames; if there is none, the
    difference between the two lowest results of different settings."""
    ranked = [line for line in lines if not line.excluded and (line.run or not any(one.run for one in lines))]
    metric = next((m for m in ("epe", "rcre") if any((m, AVERAGE) in line.values for line in ranked)), None)
    if metric is None:
        return ""
    ranked, where = [line for line in ranked if (metric, AVERAGE) in line.values], benchmark_words(board.name)
    groups: dict[Setting, list[ModelResult]] = {}
    for line in ranked:
        groups.setdefault(setting_of(line), []).append(line)
    known, of_frames = max(groups.values(), key=len), by_frames(ranked)
    if len(known) == 1 < len(ranked):
        if len(together := max(of_frames.values(), key=len)) > 1:
            return _between_settings(together[:2], metric, where)
        return f"No two of the {len(groups)} ranked results on {where} are on the same frames, so none are compared."
    verdict = content.verdicts.get(setting_of(known[0]))
    first = next((line for line in known if verdict and line.name in verdict.names[:1]), known[0])
    value = first.values[metric, AVERAGE]
    whose = f"{plain(first.name)} ({plain(first.setting, 40)})"
    number = f"{value.text} px {interval_text(value.ends)}".rstrip()
    if len(known) == 1:
        only = f"{whose} is the only ranked result on {where}"
        return f"{only}: its {LABELS[metric]} under corruption is {number}."
    if (error := first.values.get(("photometric", AVERAGE))) and metric == "rcre":
        number += f" (photometric error {error.text} grey levels)"
    same = f"the same frames of {where}" if len(of_frames) > 1 else where
    one_setting = len(groups) == len(of_frames)
    noun = "ranked result" if one_setting else f"ranked {plain(first.setting, 40)} result"
    who = whose if one_setting else plain(first.name)
    lowest = f"Of {counted(len(known), noun)} on {same}, {who} has the lowest {LABELS[metric]} under corruption"
    if verdict is None:
        return f"{lowest}, {number} (differences not tested)."
    fewer = 0 < verdict.tested < len(known)
    tested = f"the next {verdict.tested - 1}, the only ones tested" if fewer else "the others"
    only = f" (of {tested})" if fewer and verdict.kind == "not decided" else ""
    return " ".join([f"{lowest}, {number}; {verdict.ending(tested)}{only}.", *verdict.remarks])


def _between_settings(lines: Sequence[ModelResult], metric: str, where: str) -> str:
    """State the difference between two results of different settings, which are compared but not ranked together."""
    rows = {
        f"{line.name} ({line.setting})": paper_rows(line.run) if line.beside_published else line.run.rows
        for line in lines
        if line.run is not None
    }
    if len(rows) < len(lines):
        return f"No two of the ranked results on {where} have the same setting, so none are compared."
    (row,) = contrast(cubes_of(rows), {metric: MEASURES[metric]}, [(AVERAGE, None)]).to_dicts()
    return f"{difference_sentence(row)} Models of different settings are compared, but not ranked together."
