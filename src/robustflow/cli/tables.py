"""Print runs and tables: at most `MOST_LINES` lines for a run, the rest is on its page."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.errors import UsageError, unknown_name
from ..core.files import write_bytes
from ..core.output import echo, stream
from ..core.text import counted, plain
from ..data.benchmarks.facts import is_still, sample_noun, truth_remark
from ..metrics.cube import AVERAGE, PAPER
from ..metrics.measures import METRICS, UNCOUPLED
from ..metrics.rows import CLEAN
from ..report.attack_tables import SHORT, attack_table
from ..report.render import render, renderer
from ..report.render.terminal import render as render_terminal
from ..report.run_tables import confidence_table, corruptions_table, runs_table, severities_table
from ..report.table import Table, Wanted, interval_text, number_text
from ..run.manifest import UNEVEN, left_out_sentence
from ..run.run import Run
from ..stats.exclusion import CAVEAT, PHANTOM, enough_to_compare, exclusion_reasons, without_truth
from ..stats.frame import KINDS, results_frame
from ..stats.intervals import interval_ends
from ..stats.lines import lines_of
from ..stats.notes import estimate_of
from ..stats.numbers import confidence_of
from ..stats.results import LABELS, benchmark_words
from ..stats.seeds import seed_groups, seeds_of

MOST_LINES = 40
"""Maximum number of lines printed without options about one run, or about several."""


def as_json_text(results: Sequence[Run]) -> str:
    """Return the name, benchmark, folder, summary and attacks of each run as a JSON list."""
    facts = [
        {
            "name": run.name,
            "benchmark": run.benchmark,
            "folder": str(run.path),
            "summary": run.document(),
            **({"attacks": _attacks(run)} if run.attacks else {}),
        }
        for run in results
    ]
    return json.dumps(facts, indent=2)


def _attacks(run: Run) -> list[dict[str, Any]]:
    """Return the numbers of attacks, a row of the results frame each."""
    columns = ("measure", "condition", "severity", "value", "low", "high", "pairs")
    return results_frame([run], ["attacks"]).select(columns).to_dicts()


def check_metric(metric: str) -> None:
    """Reject an unknown metric before reading anything."""
    if metric not in (*METRICS, *UNCOUPLED, "all"):
        raise unknown_name("metric", metric, (*METRICS, *UNCOUPLED, "all"))


def print_result(result: Run, metric: str = "all", *, report: bool = True, with_seed: bool = False) -> None:
    """Print the means of a run by corruption, or one metric by severity, and facts about the run. With `report`, also
    print the path of the report page; with `with_seed`, print the seed even if it is 0."""
    check_metric(metric)
    pairs = f"{counted(result.measured.samples, sample_noun(result.benchmark))} of {benchmark_words(result.benchmark)}"
    heading = f"{_heading(result, with_seed)} on {pairs}"
    (numbers,) = lines_of(results_frame([result], KINDS, intervals=False)).values()
    if metric != "all":
        tables = [severities_table(numbers, metric, f"{heading}, {metric}")]
    else:
        attacked, confidence = attack_table(numbers, columns=SHORT), confidence_table(numbers, confidence_of(result))
        tables = [corruptions_table(numbers, heading)]
        tables = [] if attacked and not result.measured.corruptions else tables
        tables += [replace(attacked, remarks=())] if attacked else []
        tables += [replace(confidence, sections=confidence.sections[:1], remarks=())] if confidence else []
    facts = list(_facts(result, report))
    lines = [line for table in tables for line in for_stdout(table).splitlines()]
    _print_lines(lines, facts, "the rest is on the page; --table all prints every table")


def print_results(results: Sequence[Run]) -> None:
    """Print one line per run, the mean and standard deviation over the seeds of a model, and, if there are enough
    pairs, the command that tests whether the runs differ."""
    groups = seed_groups(results)
    facts = [f"ground truth: {remark}" for remark in sorted(set(map(_truth, results)) - {""})]
    facts += [PHANTOM] * any(is_still(run.benchmark) for run in results)
    facts += [CAVEAT] * any(map(without_truth, results))
    if all(map(enough_to_compare, results)) and (not groups or seeds_of(results) is not None):
        folders = " ".join(shlex.quote(str(run.path)) for run in results)
        question = "How much depends on the seed?" if groups else "Is the difference real?"
        facts.append(f"{question} robustflow compare {folders}")
    lines = for_stdout(runs_table(Wanted(results, False).of_runs("row", seeds=True))).splitlines()
    _print_lines(lines, facts, "--table means prints all")


def _print_lines(lines: Sequence[str], facts: Sequence[str], rest: str) -> None:
    """Print the lines of tables, as many as fit beside the facts, and the facts."""
    room = max(MOST_LINES // 2, MOST_LINES - len(facts))
    if len(lines) > room:
        lines = [*lines[: room - 1], f"... {len(lines) - room + 1} more lines: {rest}"]
    echo("\n".join([*lines, *facts]))


def _facts(run: Run, report: bool) -> Iterator[str]:
    """Yield what a reader needs to know beside a run's numbers, one line a fact."""
    measured = run.measured
    missing, unmeasured = (sum(cells.count for cells in part) for part in (measured.missing, measured.unmeasured))
    paper = measured.paper_over if set(measured.averaged_over) != set(measured.paper_over) else ()
    warnings = dict.fromkeys(text for clip in run.manifest.clips for text in clip.warnings)
    yield _overall(run)
    remarks = {
        "ground truth": _truth(run),
        "means": UNEVEN if run.manifest.uneven else "",
        "ranked against runs of the same subset": estimate_of(run),
        "RCRE only, in no mean with others": ", ".join(run.averages.without_truth),
        "paper's corruptions": f"{len(paper)}: {_means(run, PAPER)}" if paper else "",
        "not ranked": " and ".join(exclusion_reasons(run)),
        "incomplete, rows missing": missing or "",
        "incomplete, rows without a valid pixel": unmeasured or "",
        "predicted pixels NaN or infinite, in no mean": measured.n_invalid or "",
        "left out": left_out_sentence(run.left_out) if run.left_out else "",
        "warning": "; ".join(warnings),
        "note": PHANTOM if is_still(run.benchmark) else CAVEAT if without_truth(run) else "",
        "report": f"{run.path}/report.html" if report else "",
        "next": _next(run) if report else "",
    }
    yield from (f"{name}: {plain(str(text), None)}" for name, text in remarks.items() if text)


def _overall(run: Run) -> str:
    if run.rcre is None and run.epe_clean is None:
        return "nothing could be measured"
    if run.epe_clean is None:
        length = number_text(run.mean("flow_length", CLEAN))
        return f"RCRE {number_text(run.rcre)} px{_interval(run, 'rcre', AVERAGE)}; clean flow {length} px long"
    clean = f"clean EPE {number_text(run.epe_clean)} px{_interval(run, 'epe', CLEAN)}"
    return f"{clean}, {_means(run, AVERAGE)}{' (95 % intervals)' * bool(_interval(run, 'epe', AVERAGE))}"


def _next(run: Run) -> str:
    """Return the command that is useful after this run, if it is known."""
    if not run.measured.complete:
        return ""
    if enough_to_compare(run):
        runs = f"{shlex.quote(str(run.path))} OTHER_RUN"
        return f"robustflow compare {runs}, or robustflow leaderboard {runs}"
    return "robustflow run MODEL --benchmark kitti-fc --data FOLDER (too few pairs here to compare models)"


def _truth(run: Run) -> str:
    return truth_remark(run.manifest.identity.frames.protocol)


def _means(run: Run, condition: str) -> str:
    texts = (
        f"{LABELS[m]} {number_text(run.mean(m, condition))}{_interval(run, m, condition)}"
        for m in ("epe", "cre", "crer", "rcre")
    )
    return ", ".join(texts)


def _interval(run: Run, metric: str, condition: str) -> str:
    return f" {interval_text(interval_ends(run, corruptions=False).get((metric, condition, None)))}".rstrip()


def _heading(result: Run, with_seed: bool) -> str:
    made_with = result.manifest.identity.frames.made_with
    seed = made_with["seed"]
    scale = ", calibrated severities" if made_with["severity_scale"] != "paper" else ""
    return f"{plain(result.name)} ({result.setting}{f', seed {seed}' if with_seed or seed else ''}{scale})"


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
        echo(text, end="")
    else:
        write_bytes(output, text.encode())
        echo(str(output))


def for_stdout(table: Table) -> str:
    """Return the text of a table; if stdout is a terminal, it is coloured and fitted to the window."""
    if not stream().isatty():
        return render_terminal(table)
    return render_terminal(table, shutil.get_terminal_size().columns, colour=True)
