"""Tables of runs: means by corruption, severity and class, with intervals, beside accuracy, and by image region."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..core.arguments import SEVERITIES
from ..core.errors import UsageError
from ..core.text import counted, first_of, plain
from ..metrics.cube import Means
from ..metrics.measures import CONFIDENCE, UNCOUPLED
from ..run.run import Run
from ..stats.effective import effective_robustness
from ..stats.estimate import OVERALL_SCOPES, cubes_of, estimate
from ..stats.frame import confidence_means, uncoupled_means
from ..stats.inference import FEWEST
from ..stats.model_result import ModelResult, by_frames, not_ranked, ranked
from ..stats.published.tables import PAPER
from ..stats.ranking import LEAST_MODELS, spearman
from ..stats.results import (
    AVERAGE,
    CLEAN,
    FAMILY_LABELS,
    LABELS,
    METRIC_LABELS,
    RESULT_METRICS,
    SETTING_LABELS,
    benchmark_words,
    metric_label,
    on_benchmark,
)
from ..stats.run_results import comparison_note
from ..stats.seeds import SeedGroup
from .leaderboard import marked_cells
from .table import (
    Row,
    Table,
    Wanted,
    full_note,
    interval_text,
    number_text,
    rows_of_models,
)

MEANS = {("epe", CLEAN): "clean EPE (px)"} | {(metric, AVERAGE): metric_label(metric) for metric in RESULT_METRICS}
"""The overall means in tables of runs, with their labels."""
_WITHOUT_TRUTH = {
    "flow_length": "clean flow (px)",
    "photometric": "clean photometric error (grey levels)",
    "photometric_still": "of zero flow",
}
"""Measures of the clean flow in tables of runs without ground truth, with their labels."""
_MOST_NAMED = 4


Cell = tuple[str, int | None]
"""(measure, severity) of a column or (condition, severity) of a row; None for the mean over severities."""


def rows_of_means(means: Means, columns: Iterable[Cell], rows: Mapping[str, Cell]) -> list[Row]:
    """Return the row of each condition, by label, with the mean of each measure.

    >>> means = {("ause", "noise", None): 0.25, ("ause", "noise", 3): 0.5}
    >>> [row.values for row in rows_of_means(means, [("ause", None)], {"all": ("noise", None), "3": ("noise", 3)})]
    [[0.25], [0.5]]
    """
    columns = list(columns)
    return [
        Row(label, [means.get((measure, of, at or level)) for measure, level in columns])
        for label, (of, at) in rows.items()
    ]


def corruptions_table(run: Run, title: str) -> Table:
    """Tabulate the means of a run for each corruption, and its EPE (RCRE without ground truth) at each severity."""
    corruptions, levels = run.measured.corruptions, run.measured.severities
    metrics = [m for m in ("epe", "cre", "crer", "rcre") if any(run.mean(m, name) is not None for name in corruptions)]
    at_each = "epe" if "epe" in metrics else "rcre"
    metrics += ["photometric"] * (at_each == "rcre")
    metrics += ["coverage"] * run.averages.has_gaps + ["spread"] * (run.mean("spread") is not None)
    shown: list[Cell] = [*((metric, None) for metric in metrics), *((at_each, level) for level in levels)]
    rows = rows_of_means(run.means, shown, {name: (name, None) for name in corruptions})
    rows.append(Row("mean", ["" if level else run.mean(metric) for metric, level in shown]))
    labels = [LABELS.get(m, m) for m in metrics]
    labels += [f"{LABELS[at_each]} {level}" if level == levels[0] else str(level) for level in levels]
    return Table.of("corruptions", title, labels, {"": rows}, row_header="Corruption", keep_empty=True)


def severities_table(run: Run, metric: str, title: str) -> Table:
    """Tabulate a measure of a run, or one of `UNCOUPLED`, by corruption and severity, with the mean over severities."""
    numbers, names = uncoupled_means(run.rows) if metric in UNCOUPLED else run.means, run.measured.corruptions
    levels = [level for level in SEVERITIES if any((metric, name, level) in numbers for name in names)]
    rows = rows_of_means(numbers, [(metric, at) for at in (*levels, None)], {name: (name, None) for name in names})
    rows.append(Row("mean", [*[""] * len(levels), numbers.get((metric, AVERAGE, None))]))
    labels = [*map(str, levels), "mean"]
    return Table.of("severities", title, labels, {"": rows}, row_header="Corruption", keep_empty=True)


def result_table(run: Run) -> Table:
    """Tabulate the means of a run, overall and by corruption class."""
    metrics = [metric for metric in METRIC_LABELS if run.mean(metric) is not None]
    metrics = metrics[:-1] if run.epe is not None else metrics  # the photometric error replaces a missing EPE
    families = {label: name for name, label in FAMILY_LABELS.items() if run.mean("rcre", name) is not None}
    conditions: dict[str, Cell] = {label: (of, None) for label, of in ({"all": AVERAGE} | families).items()}
    rows = rows_of_means(run.means, [(metric, None) for metric in metrics], conditions)
    remarks = [f"clean EPE {run.epe_clean:.2f} px" if run.epe_clean is not None else "", comparison_note(run)]
    title = f"{run.name} ({run.setting}) on {benchmark_words(run.benchmark)}"
    return Table.of("result", title, map(metric_label, metrics), {"Means": rows}, remarks, "Corruptions")


def runs_table(results: Sequence[ModelResult], seeds: Sequence[SeedGroup] = ()) -> Table:
    """Tabulate the overall means of runs; without ground truth, also the mean length and the photometric error of the
    clean flow. For each group in `seeds`, a row with the mean and standard deviation follows the group's last run."""
    without_truth = all(line.number("epe", CLEAN) is None for line in results)
    values = {}
    for line in results:
        run = line.run if without_truth else None
        clean = (run.mean(name, CLEAN) if run else None for name in _WITHOUT_TRUTH)
        values[line.key] = [*(line.number(*key) for key in MEANS), *clean]
    columns = (*MEANS.values(), *_WITHOUT_TRUTH.values())
    return Table.of("runs", "Means", columns, {"Runs": rows_of_models(results, values, seeds)})


def row(wanted: Wanted) -> list[Table]:
    """Return the overall means of the runs, to be pasted into another table."""
    return [runs_table(wanted.of_runs("row"), wanted.seeds)]


def means(wanted: Wanted) -> list[Table]:
    """Tabulate the overall means of runs with intervals, such as "3.21 [2.50, 4.10]", and the standard deviation of ln
    EPE (of ln RCRE without ground truth), on which the coverage of the intervals depends. An interval is omitted if
    there are too few images to compute it. Published means follow as printed, without intervals."""
    results = wanted.of_runs("means") if wanted.runs or not wanted.published else []
    known: list[bool] = []
    texts, values = {}, {}
    for line in results:
        assert line.run is not None
        (cube,) = cubes_of({line.name: line.run.rows}).values()
        rows_of_line = estimate(cube, scopes=OVERALL_SCOPES).to_dicts()
        estimates = {(row["measure"], row["condition"]): row for row in rows_of_line}
        spread = estimates.get(("epe", AVERAGE), estimates.get(("rcre", AVERAGE), {})).get("log_deviation")
        shown = {key: estimates[key] for key in MEANS if key in estimates}
        ends = {key: None if one["low"] is None else (one["low"], one["high"]) for key, one in shown.items()}
        text = {key: f"{one['value']:.2f} {interval_text(ends[key])}".rstrip() for key, one in shown.items()}
        texts[line.key] = [*map(text.get, MEANS), spread]
        values[line.key] = [*(shown[key]["value"] if key in shown else None for key in MEANS), spread]
        known += [pair is not None for pair in ends.values()]
    least = f"{FEWEST} images (or sequences, if pairs belong to sequences)"
    remarks = [f"No intervals: they need at least {least}."] * bool(results)
    about = "sd(ln): standard deviation of ln EPE (ln RCRE without ground truth) over images or sequences."
    if any(known):
        remarks = ["[95 % confidence interval] over images, or over sequences if any."]
        remarks += [f"Means without an interval: fewer than {least}, or one has most of the images."] * (not all(known))
        about += " Up to 1.1, intervals cover the true mean in 93 to 98 % of simulations; at 1.35, in 90 to 93 %."
    title = "Means with intervals" if any(known) else "Means"
    sections = {"Runs": rows_of_models(results, values, wanted.seeds, texts)}
    for line, cells in marked_cells([line for line in wanted.results if line.source == "published"]).items():
        heading = f"Published on {benchmark_words(line.benchmark)}: {SETTING_LABELS[line.setting]}"
        sections.setdefault(heading, []).append(
            Row(line.name, [*(cells[key].marked if key in cells else None for key in MEANS), None], result=line)
        )
    remarks += [about] * any(of_line[-1] is not None for of_line in values.values())
    remarks += ["†: not printed in the paper, from the EPE."] * wanted.published
    return [Table.of("means", title, (*MEANS.values(), "sd(ln)"), sections, remarks)]


_CONFIDENCE_REMARK = (
    "AUSE: area between the sparsification curve and the oracle's; 0 if the least confident pixels have the largest "
    "errors. Normalised: divided by the error of each image. Error at 80 %: error of the 80 % most confident pixels. "
    "Spearman: rank correlation of confidence and error; -1 is best. Rejected: share of pixels rejected by the "
    "forward-backward check of Sundaram et al. 2010."
)
_CONFIDENCE_SHOWN = [name for name in CONFIDENCE if "_at_" not in name or name in ("error_at_80", "error_at_50")]
_CONDITIONS = {CLEAN: "Clean", AVERAGE: "All corruptions"} | FAMILY_LABELS


def confidence_table(run: Run) -> Table | None:
    """Tabulate the confidence scores of a run by corruption family and by severity; return None if it has none."""
    numbers = confidence_means(run.rows)
    if not numbers:
        return None
    known = {(condition, severity) for _, condition, severity in numbers}
    wholes: dict[str, Cell] = {label: (name, None) for name, label in _CONDITIONS.items()}
    levels: dict[str, Cell] = {f"{label} {at}": (of, at) for of, label in FAMILY_LABELS.items() for at in SEVERITIES}
    columns: list[Cell] = [(measure, None) for measure in _CONFIDENCE_SHOWN]
    sections = {
        title: rows_of_means(numbers, columns, {label: at for label, at in rows.items() if at in known})
        for title, rows in {"Means": wholes, "By severity": levels}.items()
    }
    title = f"Confidence ({run.manifest.identity.measuring.confidence})"
    labels = map(metric_label, _CONFIDENCE_SHOWN)
    return Table.of("confidence", title, labels, sections, [_CONFIDENCE_REMARK], "Corruptions")


_CORRELATIONS = {"rank_correlation": "rank correlation", "rank_correlation_given_motion": "given the motion"}
_UNCOUPLED_REMARK = (
    "log ratio: ln(EPE / clean EPE), averaged over images; 0.69 if errors double. Medians are over images. "
    "Fl increase: percentage points of Fl-all. Rank correlation: between corrupted and clean EPE over images, first "
    "uncontrolled, then controlled for the true flow magnitude. CRE is EPE - clean EPE, so it depends on accuracy."
)


def uncoupled(wanted: Wanted) -> list[Table]:
    """Tabulate the measures that depend less on accuracy than CRE. With five or more ranked models on the same frames,
    add the rank correlations of CRE and log ratio with the clean EPE."""
    results = wanted.of_runs("uncoupled")
    rows, same_frames = [], dict[str, list[tuple[float, float, float]]]()
    for result in results:
        assert result.run is not None
        numbers, clean, cre = uncoupled_means(result.run.rows), result.run.epe_clean, result.run.cre
        values = {name: numbers.get((name, AVERAGE, None)) for name in (*UNCOUPLED, *_CORRELATIONS)}
        ratio = values["log_ratio"]
        if ratio is None and values["median_cre"] is None:
            continue
        rows.append(Row(result.name, (clean, cre, *values.values()), full_note(result), result=result))
        if clean is not None and cre is not None and ratio is not None and not result.excluded:
            same_frames.setdefault(result.frames, []).append((clean, cre, ratio))
    if not rows:
        raise UsageError("--table", "'uncoupled' needs ground truth, which none of these runs has")
    remarks = [_UNCOUPLED_REMARK]
    for models in same_frames.values():
        if len(models) >= LEAST_MODELS:
            accuracy, *others = map(list, zip(*models, strict=True))
            of_cre, of_ratio = (number_text(spearman(accuracy, one), "{:+.2f}") for one in others)
            remarks.append(
                f"Rank correlation with the clean EPE over {len(models)} models: CRE {of_cre}, log ratio {of_ratio}."
            )
    remarks.append(left_out_remark(results))
    labels = ("clean EPE (px)", "CRE (px)", *map(metric_label, UNCOUPLED), *_CORRELATIONS.values())
    return [Table.of("uncoupled", "Robustness beside accuracy", labels, {"Runs": rows}, remarks)]


def left_out_remark(results: Sequence[ModelResult]) -> str:
    """Return the remark that names the runs omitted from statements about models in general; "" if there are none."""
    reasons = not_ranked(results)
    return f"Left out of trends and correlations: {'; '.join(reasons)}." if reasons else ""


def effective(wanted: Wanted) -> list[Table]:
    """Tabulate the effective robustness for each set of comparable results with enough models."""
    tables: list[Table] = []
    reason = UsageError("there are no results")
    for frames, lines in by_frames(wanted.results).items():
        part = ranked(lines)
        if not any(line.values for line in part):
            continue
        try:
            settings = effective_robustness(part)
        except UsageError as error:
            reason = error
            continue
        models = first_of([plain(name) for name in dict.fromkeys(line.name for line in part)], _MOST_NAMED)
        whose = "published models" if frames == PAPER else on_benchmark(models, part[0].benchmark)
        sections = {
            SETTING_LABELS.get(setting, setting): [
                Row(of.line.name, (of.clean, of.corrupted, of.expected, of.factor), full_note(of.line), result=of.line)
                for of in of_setting
            ]
            for setting, of_setting in settings.items()
        }
        remarks = [
            "factor: EPE / EPE expected from the clean EPE by a fit to the other models; below 1: more robust than "
            "expected from accuracy.",
            left_out_remark(lines),
        ]
        labels = ("clean EPE", "EPE", "expected EPE", "factor")
        tables.append(Table.of("effective", f"Effective robustness: {whose}", labels, sections, remarks))
    if not tables:
        raise reason
    return tables


def signed(rho: float | None, interval: tuple[float, float] | None) -> list[str]:
    """Return a correlation and the ends of its interval with their signs."""
    return [number_text(value, "{:+.2f}") for value in (rho, *(interval or (None, None)))]


def few_note(models: int) -> str:
    """Return the note on a correlation that too few models have; "" if there are enough.

    >>> few_note(3), few_note(12)
    ('3 models: fewer than the 5 of a correlation', '')
    """
    few = f"{counted(models, 'model')}: fewer than the {LEAST_MODELS} of a correlation"
    return few if models < LEAST_MODELS else ""
