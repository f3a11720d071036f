"""Tables of results for the terminal, in the paper's column order."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table

from ..analysis.attacks import attack_scores
from ..analysis.conclusion import conclusions, enough_to_compare, without_truth
from ..analysis.conditions import seed_groups, seeds_of
from ..analysis.exclusion import exclusion_reasons
from ..analysis.labels import METRIC_LABELS
from ..analysis.model_result import ModelResult, not_ranked, ranked
from ..analysis.run_results import run_results
from ..analysis.still import PHANTOM, phantom_motion
from ..analysis.uncoupled import UNCOUPLED, uncoupled
from ..atomic import write_bytes
from ..benchmarks import benchmark_facts
from ..benchmarks.facts import estimate_remark, sample_noun, truth_remark
from ..errors import UsageError, unknown_name
from ..metrics.summary import METRICS, Scores, has_gaps
from ..report import table as report_table
from ..report.attack_table import attack_table
from ..report.confidence_table import confidence_table
from ..report.render import render, renderer
from ..report.render.terminal import render as render_terminal
from ..runs.plan import left_out_sentence
from ..runs.run import Run
from ..text import counted, plain


def as_json_text(results: Sequence[Run]) -> str:
    """Return name, benchmark, folder, summary and attacks of runs as a JSON list."""
    facts = [
        {
            "name": each.name,
            "benchmark": each.benchmark,
            "folder": str(each.path),
            "summary": each.document(),
            **({"attacks": [asdict(score) for score in attack_scores(each)]} if each.attacks else {}),
        }
        for each in results
    ]
    return json.dumps(facts, indent=2)


def print_result(result: Run, metric: str = "all", *, report: bool = True, with_seed: bool = False) -> None:
    """Print the overall scores and one line per corruption to stdout; `report`: where its page is, too; `with_seed`:
    the seed, even if it is 0."""
    if metric != "all" and metric not in (*METRICS, *UNCOUPLED):
        raise unknown_name("metric", metric, (*METRICS, *UNCOUPLED, "all"))
    summary, whose = result.summary, _whose(result, with_seed)
    # Names and folders may contain what rich would read as markup.
    console = Console(width=None if Console().is_terminal else 120, markup=False)
    attacked = attack_table(result) if metric == "all" else None
    confidence = confidence_table(result) if metric == "all" else None
    if metric == "all" and (summary.corruptions or attacked is None):
        console.print(_overview(result, whose))
    elif metric != "all":
        console.print(_by_severity(result, metric, whose))
    console.print(_sentence(result), highlight=False, soft_wrap=True)
    selected = result.manifest.selection
    if estimate := estimate_remark(benchmark_facts(result.benchmark), selected.corruptions, selected.severities):
        console.print(f"This is {estimate}; it is ranked with other runs of the subset only.", soft_wrap=True)
    if phantom := phantom_motion(result):
        console.print(f"{plain(phantom, None)}\n{PHANTOM}", highlight=False, soft_wrap=True)
    if attacked is not None:
        print(for_stdout(attacked))
    if confidence is not None:
        print(for_stdout(replace(confidence, sections=confidence.sections[:1])))  # severities are on the page
    if metric in UNCOUPLED:
        overall = getattr(uncoupled(result.rows).overall, metric)
        console.print(f"{metric} {cell(overall)}, the mean over corruptions", highlight=False, soft_wrap=True)
    if reasons := exclusion_reasons(result):
        sentence = f"This says nothing about robustness: {' and '.join(reasons)}."
        console.print(plain(sentence, None), highlight=False, soft_wrap=True)
    if summary.paper is not None and set(summary.averaged_over) != set(summary.paper_over):
        line = f"the paper's mean, over its {len(summary.paper_over)} corruptions: {_means(summary.paper)}"
        console.print(line, highlight=False, soft_wrap=True)
    missing, unmeasured = (sum(len(unit.samples) for unit in units) for units in (summary.missing, summary.unmeasured))
    _print_conclusions(console, run_results([result]))
    if missing:
        cells = "row is" if missing == 1 else "rows are"
        console.print(f"Incomplete: {missing} planned {cells} missing; the means are over the rest.")
    if unmeasured:
        have = "row has" if unmeasured == 1 else "rows have"
        console.print(f"Incomplete: {unmeasured} {have} no pixel to measure; the means are over the rest.")
    if summary.n_invalid:
        console.print(f"{summary.n_invalid} predicted pixels were NaN or infinite; they are excluded from all means.")
    for warning in dict.fromkeys(text for clip in result.manifest.clips for text in clip.warnings):
        console.print(f"Warning: {plain(warning, None)}", highlight=False, soft_wrap=True)
    if result.left_out:
        console.print(f"Left out: {left_out_sentence(result.left_out)}.", highlight=False, soft_wrap=True)
    if report:
        console.print(f"report: {result.path / 'report.html'}", highlight=False, soft_wrap=True)


def print_results(results: Sequence[Run]) -> None:
    """Print one line per run, the mean and standard deviation over the seeds of a model, and the command that tells
    whether the runs differ, if there are pairs enough to tell."""
    console = Console(width=None if Console().is_terminal else 120, markup=False)
    summaries = [result.summary for result in results]
    headings = {"epe_clean": "clean EPE", **{name: METRIC_LABELS[name] for name in ("epe", "cre", "crer", "rcre")}}
    if all(summary.epe_clean is None for summary in summaries):
        headings["clean_flow_length"] = "clean flow (px)"
    shown = [name for name in headings if any(getattr(summary, name) is not None for summary in summaries)]
    lines, groups = run_results(results), seed_groups(results)
    names = [line.name for line in lines]
    table = Table(title=f"{len(results)} {'runs' if groups else 'models'}", title_justify="left")
    table.add_column("model")
    for name in shown:
        table.add_column(headings[name], justify="right")
    values = {name: [getattr(summary, key) for key in shown] for name, summary in zip(names, summaries, strict=True)}
    for name, numbers in values.items():
        table.add_row(plain(name), *map(cell, numbers))
    for group in groups:
        of_runs = zip(*(values[name] for _, name in group.runs), strict=True)
        table.add_row(plain(group.label), *map(report_table.spread_text, of_runs), style="bold")
    console.print(table)
    for note in dict.fromkeys(group.note for group in groups):
        console.print(f"{note[0].upper()}{note[1:]}.", highlight=False)
    for remark in {truth_remark(result.manifest.identity.frames.protocol) for result in results} - {""}:
        console.print(f"Errors are on {remark}.")
    for run in results:
        if phantom := phantom_motion(run):
            console.print(f"{plain(run.name)}: {plain(phantom, None)}", highlight=False, soft_wrap=True)
    for sentence in not_ranked(line for line in lines if line.run is not None and not without_truth(line.run)):
        console.print(sentence, highlight=False, soft_wrap=True)
    _print_conclusions(console, lines)
    if all(map(enough_to_compare, results)) and (question := _question(lines, len(groups))):
        folders = " ".join(shlex.quote(str(result.path)) for result in results)
        console.print(f"{question} robustflow compare {folders}", highlight=False, soft_wrap=True)


def _question(lines: Sequence[ModelResult], groups: int) -> str:
    """What `compare` can say about the runs; "" if it would refuse."""
    if not groups:
        return "Is the difference real?"
    if seeds_of([line.run for line in lines if line.run is not None]) is not None:
        return "How much depends on the seed?"
    if len(ranked(lines)) == len(lines):
        return "Do the models keep their order with every seed?"
    return ""


def _print_conclusions(console: Console, lines: Sequence[ModelResult]) -> None:
    for conclusion in conclusions(lines):
        console.print(conclusion, highlight=False, soft_wrap=True)


def check_format(format: str, as_json: bool) -> None:
    """Refuse an unknown format before anything is read, and one beside `--json`."""
    renderer(format)
    if as_json and format != "terminal":
        raise UsageError(f"--json and --format {format} exclude each other; leave out one of them")


def as_text(table: report_table.Table, format: str, output: Path | None) -> str:
    """A table in a format; on the terminal, which has no `output`, see `for_stdout`."""
    return for_stdout(table) if format == "terminal" and output is None else render(table, format)


def write_text(text: str, output: Path | None) -> None:
    """Print a text, or write it to a file and print its path."""
    if output is None:
        typer.echo(text, nl=False)
    else:
        write_bytes(output, text.encode())
        typer.echo(str(output))


def for_stdout(table: report_table.Table) -> str:
    """The text of a table, coloured and as wide as the window where stdout is a terminal."""
    if not sys.stdout.isatty():
        return render_terminal(table)
    return render_terminal(table, shutil.get_terminal_size().columns, colour=True)


def _overview(result: Run, whose: str) -> Table:
    summary = result.summary
    table = Table(title=f"{whose}, {counted(summary.samples, sample_noun(result.benchmark))}", title_justify="left")
    table.add_column("corruption")
    shown = [
        m
        for m in ("epe", "cre", "crer", "rcre")
        if any(getattr(s, m) is not None for s in summary.corruptions.values())
    ]
    if has_gaps(summary):
        shown.append("coverage")
    if summary.spread is not None:
        shown.append("spread")
    for metric in shown:
        table.add_column(METRIC_LABELS.get(metric, metric), justify="right")
    at_each = "epe" if "epe" in shown else "rcre"
    levels = summary.severities()
    for level in levels:
        table.add_column(f"{METRIC_LABELS[at_each]} {level}" if level == levels[0] else str(level), justify="right")
    family = None
    for corruption, scores in summary.corruptions.items():
        if family is not None and scores.family != family:
            table.add_section()
        family = scores.family
        values = dict(zip(scores.severities, scores.by_severity[at_each], strict=True))
        means = [getattr(scores, metric) for metric in shown]
        table.add_row(corruption, *map(cell, means), *(cell(values.get(level)) for level in levels))
    table.add_section()
    table.add_row("mean", *(cell(getattr(summary, metric)) for metric in shown), *[""] * len(levels), style="bold")
    return table


def _by_severity(result: Run, metric: str, whose: str) -> Table:
    frame = uncoupled(result.rows).table(metric) if metric in UNCOUPLED else result.table(metric)
    table = Table(title=f"{whose}, {metric}", title_justify="left")
    for column in frame.columns:
        table.add_column(column, justify="left" if column in ("corruption", "family") else "right")
    for row in frame.iter_rows():
        table.add_row(*(value if isinstance(value, str) else cell(value) for value in row))
    return table


def _whose(result: Run, with_seed: bool) -> str:
    seed = result.manifest.identity.frames.seed
    return f"{plain(result.name)} ({result.setting}{f', seed {seed}' if with_seed or seed else ''})"


def _sentence(result: Run) -> str:
    summary = result.summary
    if summary.rcre is None:
        return "nothing could be measured" if summary.epe_clean is None else f"clean EPE {cell(summary.epe_clean)} px"
    if summary.epe_clean is None:
        length = f"; on clean frames the flow is {cell(summary.clean_flow_length)} px long on average"
        return f"RCRE {cell(summary.rcre)} px{length} (no ground truth: EPE, CRE and CREr cannot be measured)"
    truth = truth_remark(result.manifest.identity.frames.protocol)
    return f"clean EPE {cell(summary.epe_clean)} px, {_means(summary)}{f'; {truth}' if truth else ''}"


def _means(scores: Scores) -> str:
    each = ", ".join(f"{METRIC_LABELS[m]} {cell(getattr(scores, m))}" for m in ("epe", "cre", "crer", "rcre"))
    return each if scores.coverage in (None, 1.0) else f"{each}, coverage {cell(scores.coverage)}"


def cell(value: float | None) -> str:
    """A number with two decimals, or a dash.

    >>> cell(1.005), cell(None)
    ('1.00', '-')
    """
    return "-" if value is None else f"{value:.2f}"
