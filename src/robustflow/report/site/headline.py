"""The headline of a board: one sentence from its numbers, and one picture of the worst that happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import polars as pl

from ...core.text import counted, plain
from ...data.benchmarks.facts import is_still, sample_noun
from ...metrics.measures import LEADING
from ...stats.lines import LineKey, Lines, Numbers, by_sample_set, number_of, ranked
from ...stats.paired import difference_sentence
from ...stats.results import AVERAGE, CLEAN, LABELS, benchmark_words, inside, long_label
from ..attack_tables import attacks_of
from ..leaderboard import EPE_CLEAN
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


def headline_of(content: Content, board: Table, panels: Mapping[LineKey, Sequence[PanelPicture]]) -> Headline:
    """Return the headline of a board: about its run, its runs, or the values that have no run."""
    lines = {key: content.lines[key] for line in board.lines if (key := line.result) is not None}
    runs = {key: numbers for key, numbers in lines.items() if numbers.is_run}
    sentence = _about_run(*next(iter(runs.items()))) if len(runs) == 1 else _about_lines(content, board, lines)
    if sentence and is_still(board.name):
        sentence += " Zero flow is correct here, because nothing moves."
    elif sentence and all(EPE_CLEAN not in numbers for numbers in lines.values()):
        sentence += " A flow that is too short has a low RCRE."
    pictured = next((key for key in runs if panels.get(key)), None)
    if pictured is None:
        return Headline(sentence)
    panel = panels[pictured][0]
    panel = replace(panel, title=f"{plain(pictured.model)}. {panel.title}")
    return Headline(sentence, [panel.tiles[place] for place in panel.shown], panel, content.pages[pictured])


def _about_run(key: LineKey, numbers: Numbers) -> str:
    """State the error of a run on the clean frames and under corruption, and where it is largest."""
    averaged = [of for measure, of, _ in numbers if measure == "averaged"]
    known = {measure for measure, of, _ in numbers if of in (AVERAGE, CLEAN)}
    metric = LEADING if LEADING in known or "rcre" not in known else "rcre"
    attacks = [(attack, at) for attack, levels in attacks_of(numbers).items() for at in levels]
    cells = [
        (row["value"], f"{inside(long_label(of))} at severity {at}")
        for (measure, of, at), row in numbers.items()
        if measure == metric and of in averaged and at is not None
    ] or [
        (numbers[metric, attack, at]["value"], f"the attack {attack} at severity {at}")
        for attack, at in attacks
        if (metric, attack, at) in numbers
    ]
    pairs = next(iter(numbers.values()))["pairs"]
    where = f"{counted(pairs, sample_noun(key.benchmark))} of {benchmark_words(key.benchmark)}"
    if not cells:
        return f"{plain(key.model)}: nothing could be measured on {where}."
    (value, most), whole = max(cells), numbers.number(metric, AVERAGE)
    clean = numbers.number(metric, CLEAN) if metric == LEADING else None
    over = {"on the clean frames": clean, f"under {counted(len(averaged), 'corruption')}": whole}
    means = " and ".join(f"{mean:.2f} px {condition}" for condition, mean in over.items() if mean is not None)
    head = f"{plain(key.model)}: {LABELS[metric]} {means}".rstrip()
    highest = f", highest for {most}: {value:.2f} px" if whole is None or value > whole else ""
    return f"{head} ({where}){highest}."


def _about_lines(content: Content, board: Table, lines: Lines) -> str:
    """State the verdict on the largest group of results of one setting on the same frames; if there is none, the
    difference between the two lowest results of different settings."""
    of_runs = any(numbers.is_run for numbers in lines.values())
    some = {key: numbers for key, numbers in ranked(lines).items() if numbers.is_run or not of_runs}
    metric = next((m for m in (LEADING, "rcre") if any((m, AVERAGE, None) in n for n in some.values())), None)
    if metric is None:
        return ""
    some = {key: numbers for key, numbers in some.items() if (metric, AVERAGE, None) in numbers}
    where = benchmark_words(board.name)
    groups: dict[tuple[str, str, str], list[LineKey]] = {}
    for key in some:
        groups.setdefault(key.comparable, []).append(key)
    known, of_frames = max(groups.values(), key=len), by_sample_set(some)
    if len(known) == 1 < len(some):
        if len(together := [*max(of_frames.values(), key=len)]) > 1:
            return _between_settings(content, together[:2], metric, where)
        return f"No two of the {len(groups)} ranked results on {where} are on the same frames, so none are compared."
    verdict = content.verdicts.get(known[0].comparable)
    first = next((key for key in known if verdict and key.model in verdict.names[:1]), known[0])
    numbers = some[first]
    ends, value = numbers.ends(metric, AVERAGE), number_of(numbers[metric, AVERAGE, None])
    whose = f"{plain(first.model)} ({plain(first.setting, 40)})"
    number = f"{value} px {interval_text(ends)}".rstrip()
    if len(known) == 1:
        only = f"{whose} is the only ranked result on {where}"
        return f"{only}: its {LABELS[metric]} under corruption is {number}."
    if (error := numbers.get(("photometric", AVERAGE, None))) and metric == "rcre":
        number += f" (photometric error {number_of(error)} grey levels)"
    same = f"the same frames of {where}" if len(of_frames) > 1 else where
    one_setting = len(groups) == len(of_frames)
    noun = "ranked result" if one_setting else f"ranked {plain(first.setting, 40)} result"
    who = whose if one_setting else plain(first.model)
    lowest = f"Of {counted(len(known), noun)} on {same}, {who} has the lowest {LABELS[metric]} under corruption"
    if verdict is None:
        return f"{lowest}, {number} (differences not tested)."
    fewer = 0 < verdict.tested < len(known)
    tested = f"the next {verdict.tested - 1}, the only ones tested" if fewer else "the others"
    only = f" (of {tested})" if fewer and verdict.kind == "not decided" else ""
    return " ".join([f"{lowest}, {number}; {verdict.ending(tested)}{only}.", *verdict.remarks])


def _between_settings(content: Content, keys: Sequence[LineKey], metric: str, where: str) -> str:
    """State the difference between two results of different settings, which are compared but not ranked together."""
    one, other = (key.model for key in keys)
    both = pl.col("model").is_in([one, other]) & pl.col("against").is_in([one, other])
    tests = content.frame.filter(both, measure=metric, condition=AVERAGE, sample_set=keys[0].sample_set)
    if tests.is_empty():
        return f"No two of the ranked results on {where} have the same setting, so none are compared."
    row = tests.row(0, named=True)
    named = {key.model: f"{key.model} ({key.setting})" for key in keys}
    sentence = difference_sentence(row | {whose: named[row[whose]] for whose in ("model", "against")})
    return f"{sentence} Models of different settings are compared, but not ranked together."
