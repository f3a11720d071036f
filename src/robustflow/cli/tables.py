"""Tables of results for the terminal, in the paper's column order."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import typer
from rich.console import Console

from ..core.errors import UsageError, unknown_name
from ..core.files import write_bytes
from ..core.text import counted, joined, plain
from ..data.benchmarks.facts import sample_noun, truth_remark
from ..metrics.means import AVERAGE, PAPER
from ..metrics.measures import METRICS, UNCOUPLED
from ..metrics.rows import CLEAN
from ..report.attack_table import attack_table
from ..report.confidence_table import confidence_table
from ..report.render import render, renderer
from ..report.render.terminal import render as render_terminal
from ..report.table import Table, number_text
from ..report.tables import corruptions_table, runs_table, severities_table
from ..run.cells import UNEVEN
from ..run.plan import left_out_sentence
from ..run.run import Run
from ..stats.attacks import attack_scores
from ..stats.conditions import seed_groups, seeds_of
from ..stats.exclusion import (
    CAVEAT,
    PHANTOM,
    enough_to_compare,
    exclusion_reasons,
    phantom_motion,
    without_truth,
)
from ..stats.frame import uncoupled_means
from ..stats.model_result import ModelResult
from ..stats.results import METRIC_LABELS
from ..stats.run_results import estimate_of, run_results


def as_json_text(results: Sequence[Run]) -> str:
    """Return the name, benchmark, folder, summary and attacks of each run as a JSON list."""
    facts = [
        {
            "name": each.name,
            "benchmark": each.benchmark,
            "folder": str(each.path),
            "summary": each.document(),
            **({"attacks": attack_scores(each)} if each.attacks else {}),
        }
        for each in results
    ]
    return json.dumps(facts, indent=2)


def print_result(result: Run, metric: str = "all", *, report: bool = True, with_seed: bool = False) -> None:
    """Print the overall scores and one line per corruption to stdout. With `report`, also print the path of the report
    page; with `with_seed`, print the seed even if it is 0."""
    if metric != "all" and metric not in (*METRICS, *UNCOUPLED):
        raise unknown_name("metric", metric, (*METRICS, *UNCOUPLED, "all"))
    measured, whose = result.measured, _heading(result, with_seed)
    console = _console()
    attacked = attack_table(result) if metric == "all" else None
    confidence = confidence_table(result) if metric == "all" else None
    if metric == "all" and (measured.corruptions or attacked is None):
        pairs = counted(measured.samples, sample_noun(result.benchmark))
        print(for_stdout(corruptions_table(result, f"{whose}, {pairs}")), end="")
    elif metric != "all":
        print(for_stdout(severities_table(result, metric, f"{whose}, {metric}")), end="")
    console.print(_sentence(result))
    if estimate := estimate_of(result):
        console.print(f"This is {estimate}; it is ranked only against runs of the same subset.")
    if result.manifest.uneven:
        console.print(f"The means are over corruptions measured on unlike conditions: {UNEVEN}.")
    if phantom := phantom_motion(result):
        console.print(f"{plain(phantom, None)}\n{PHANTOM}")
    if moved := [plain(name) for name in result.averages.without_truth]:
        leave = "leaves" if len(moved) == 1 else "leave"
        console.print(f"{joined(moved)} {leave} no ground truth: RCRE only, and no mean includes it beside others.")
    if attacked is not None:
        print(for_stdout(attacked))
    if confidence is not None:
        print(for_stdout(replace(confidence, sections=confidence.sections[:1])))  # the page has the values by severity
    if metric in UNCOUPLED:
        overall = uncoupled_means(result.rows).get((metric, AVERAGE, None))
        console.print(f"{metric} {number_text(overall)}, the mean over corruptions")
    if reasons := exclusion_reasons(result):
        sentence = f"Not a measure of robustness: {' and '.join(reasons)}."
        console.print(plain(sentence, None))
    if measured.paper_over and set(measured.averaged_over) != set(measured.paper_over):
        number = len(measured.paper_over)
        console.print(f"mean over the paper's {number} corruptions: {_means(result, PAPER)}")
    missing, unmeasured = (
        sum(len(unit.samples) for unit in units) for units in (measured.missing, measured.unmeasured)
    )
    if without_truth(result):
        console.print(CAVEAT)
    if missing:
        cells = "row is" if missing == 1 else "rows are"
        console.print(f"Incomplete: {missing} planned {cells} missing; the means are over the rest.")
    if unmeasured:
        have = "row has" if unmeasured == 1 else "rows have"
        console.print(f"Incomplete: {unmeasured} {have} no valid pixel; the means are over the others.")
    if measured.n_invalid:
        console.print(f"{measured.n_invalid} predicted pixels were NaN or infinite; they are excluded from all means.")
    for warning in dict.fromkeys(text for clip in result.manifest.clips for text in clip.warnings):
        console.print(f"Warning: {plain(warning, None)}")
    if result.left_out:
        console.print(f"Left out: {left_out_sentence(result.left_out)}.")
    if report:
        console.print(f"report: {plain(str(result.path), None)}/report.html")


def print_results(results: Sequence[Run]) -> None:
    """Print one line per run, the mean and standard deviation over the seeds of a model, and, if there are enough
    pairs, the command that tests whether the runs differ."""
    console = _console()
    lines, groups = run_results(results), seed_groups(results)
    print(for_stdout(runs_table(lines, groups)), end="")
    for remark in {truth_remark(result.manifest.identity.frames.protocol) for result in results} - {""}:
        console.print(f"Errors are measured on {remark}.")
    for run in results:
        if phantom := phantom_motion(run):
            console.print(f"{plain(run.name)}: {plain(phantom, None)}")
    if any(map(without_truth, results)):
        console.print(CAVEAT)
    if all(map(enough_to_compare, results)) and (question := _question(lines, len(groups))):
        folders = " ".join(shlex.quote(str(result.path)) for result in results)
        console.print(f"{question} robustflow compare {folders}")


def _console() -> Console:
    # names and folders may contain text that rich would interpret as markup
    return Console(markup=False, highlight=False, soft_wrap=True)


def _question(lines: Sequence[ModelResult], groups: int) -> str:
    """Return the question that `compare` can answer about the runs; "" if they cannot be compared."""
    if not groups:
        return "Is the difference real?"
    one_model = seeds_of([line.run for line in lines if line.run is not None]) is not None
    return "How much depends on the seed?" if one_model else ""


def check_format(format: str, as_json: bool) -> None:
    """Reject an unknown format before reading anything, and any format combined with `--json`."""
    renderer(format)
    if as_json and format != "terminal":
        raise UsageError("--json", f"not possible with --format {format}; omit one of them")


def as_text(table: Table, format: str, output: Path | None) -> str:
    """Return a table in a format; for the terminal (no `output`), see `for_stdout`."""
    return for_stdout(table) if format == "terminal" and output is None else render(table, format)


def write_text(text: str, output: Path | None) -> None:
    """Print a text, or write it to a file and print its path."""
    if output is None:
        typer.echo(text, nl=False)
    else:
        write_bytes(output, text.encode())
        typer.echo(str(output))


def for_stdout(table: Table) -> str:
    """Return the text of a table; if stdout is a terminal, it is coloured and fitted to the window."""
    if not sys.stdout.isatty():
        return render_terminal(table)
    return render_terminal(table, shutil.get_terminal_size().columns, colour=True)


def _heading(result: Run, with_seed: bool) -> str:
    made_with = result.manifest.identity.frames.made_with
    seed = made_with["seed"]
    scale = ", calibrated severities" if made_with["severity_scale"] != "paper" else ""
    return f"{plain(result.name)} ({result.setting}{f', seed {seed}' if with_seed or seed else ''}{scale})"


def _sentence(result: Run) -> str:
    clean = f"clean EPE {number_text(result.epe_clean)} px"
    if result.rcre is None:
        return "nothing could be measured" if result.epe_clean is None else clean
    if result.epe_clean is None:
        length = (
            f"; on clean frames, the mean length of the flow is {number_text(result.mean('flow_length', CLEAN))} px"
        )
        return f"RCRE {number_text(result.rcre)} px{length} (no ground truth: EPE, CRE and CREr cannot be measured)"
    truth = truth_remark(result.manifest.identity.frames.protocol)
    return f"{clean}, {_means(result, AVERAGE)}{f'; {truth}' if truth else ''}"


def _means(run: Run, condition: str) -> str:
    each = (f"{METRIC_LABELS[m]} {number_text(run.mean(m, condition))}" for m in ("epe", "cre", "crer", "rcre"))
    coverage = run.mean("coverage", condition)
    return ", ".join(each) + ("" if coverage in (None, 1.0) else f", coverage {number_text(coverage)}")
