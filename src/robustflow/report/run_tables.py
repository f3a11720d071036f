"""Tables of runs: means by corruption, severity and class, with intervals, and beside accuracy."""

from __future__ import annotations

from ..core.arguments import SEVERITIES
from ..core.errors import UsageError
from ..core.text import first_of, plain
from ..corruptions.registry import MEMBERS
from ..metrics.measures import CONFIDENCE, LEADING, UNCOUPLED
from ..stats.effective import effective_robustness
from ..stats.exclusion import not_ranked
from ..stats.inference import FEWEST
from ..stats.lines import LineKey, Lines, Numbers, by_sample_set, ranked
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
from .leaderboard import marked_cells
from .table import (
    Column,
    Condition,
    Row,
    Table,
    Wanted,
    condition_rows,
    full_note,
    model_rows,
    number_text,
    without_seeds,
)

MEANS = (
    Column("clean EPE (px)", key=(LEADING, CLEAN, None)),
    *(Column(metric_label(metric), key=(metric, AVERAGE, None)) for metric in RESULT_METRICS),
)
"""The overall means in tables of runs."""
_WITHOUT_TRUTH = (
    Column("clean flow (px)", key=("flow_length", CLEAN, None)),
    Column("clean photometric error (grey levels)", key=("photometric", CLEAN, None)),
    Column("of zero flow", key=("photometric_still", CLEAN, None)),
)
"""Measures of the clean flow in tables of runs without ground truth."""
_MOST_NAMED = 4


def corruptions_table(numbers: Numbers, title: str) -> Table:
    """Tabulate the means of a run for each corruption, and its EPE (RCRE without ground truth) at each severity."""
    names = numbers.corruptions()
    at_each = LEADING if numbers.by_corruption(LEADING) else "rcre"
    metrics = [m for m in ("epe", "cre", "crer", "rcre") if numbers.by_corruption(m)]
    metrics += ["photometric"] * (at_each != LEADING) + ["coverage"] * numbers.has_gaps
    metrics += ["spread"] * (numbers.number("spread", AVERAGE) is not None)
    levels = numbers.severities()
    columns = [Column(LABELS[metric], key=(metric, None)) for metric in metrics]
    columns += [Column(f"{LABELS[at_each]} {at}" if at == levels[0] else f"{at}", key=(at_each, at)) for at in levels]
    rows = condition_rows(numbers, columns, {name: (name, None) for name in names})
    rows.append(Row("mean", ["" if at else numbers.number(metric, AVERAGE) for metric, at in (c.key for c in columns)]))
    return Table.of("corruptions", title, columns, {"": rows}, row_header="Corruption", keep_empty=True)


def severities_table(numbers: Numbers, metric: str, title: str) -> Table:
    """Tabulate a measure of a run by corruption and severity, with the mean over severities."""
    names = numbers.corruptions()
    levels = [at for at in SEVERITIES if any((metric, name, at) in numbers for name in names)]
    columns = [Column(str(at), key=(metric, at)) for at in levels] + [Column("mean", key=(metric, None))]
    rows = condition_rows(numbers, columns, {name: (name, None) for name in names})
    rows.append(Row("mean", [*[""] * len(levels), numbers.number(metric, AVERAGE)]))
    return Table.of("severities", title, columns, {"": rows}, row_header="Corruption", keep_empty=True)


def result_table(key: LineKey, numbers: Numbers) -> Table:
    """Tabulate the means of a run, overall and by corruption class."""
    known = [metric for metric in METRIC_LABELS if numbers.number(metric, AVERAGE) is not None]
    known = known[:-1] if LEADING in known else known  # the photometric error replaces a missing EPE
    columns = [Column(metric_label(metric), key=(metric, None)) for metric in known]
    families = {label: name for name, label in FAMILY_LABELS.items() if ("rcre", name, None) in numbers}
    rows = condition_rows(numbers, columns, {name: (of, None) for name, of in ({"all": AVERAGE} | families).items()})
    clean = numbers.number(LEADING, CLEAN)
    remarks = [f"clean EPE {clean:.2f} px" if clean is not None else "", numbers.fact("note")]
    title = f"{key.model} ({key.setting}) on {benchmark_words(key.benchmark)}"
    return Table.of("result", title, columns, {"Means": rows}, remarks, "Corruptions")


def runs_table(lines: Lines) -> Table:
    """Tabulate the overall means of runs; without ground truth, also the mean length and the photometric error of the
    clean flow."""
    without_truth = all((LEADING, CLEAN, None) not in numbers for numbers in lines.values())
    columns = [*MEANS, *_WITHOUT_TRUTH * without_truth]
    return Table.of("runs", "Means", columns, {"Runs": model_rows(lines, columns)})


def row(wanted: Wanted) -> list[Table]:
    """Return the overall means of the runs, to be pasted into another table."""
    return [runs_table(wanted.of_runs("row", seeds=True))]


def means(wanted: Wanted) -> list[Table]:
    """Tabulate the overall means of runs with intervals, such as "3.21 [2.50, 4.10]", and the standard deviation of ln
    EPE (of ln RCRE without ground truth), on which the coverage of the intervals depends. An interval is omitted if
    there are too few images to compute it. Published means follow as printed, without intervals."""
    lines = wanted.of_runs("means", intervals=True, seeds=True) if wanted.runs or not wanted.published else {}
    rows = [
        made._replace(values=[*made.values, _spread(numbers)])
        for made, numbers in zip(model_rows(lines, MEANS, with_interval=True), lines.values(), strict=True)
    ]
    keys = [column.key for column in MEANS]
    shown = [n[key] for n in without_seeds(lines).values() for key in keys if key in n]
    known = [shown_row["low"] is not None for shown_row in shown]
    least = f"{FEWEST} images (or sequences, if pairs belong to sequences)"
    remarks = [f"No intervals: they need at least {least}."] * bool(lines)
    about = "sd(ln): standard deviation of ln EPE (ln RCRE without ground truth) over images or sequences."
    if any(known):
        remarks = ["[95 % confidence interval] over images, or over sequences if any."]
        remarks += [f"Means without an interval: fewer than {least}, or one has most of the images."] * (not all(known))
        about += " Up to 1.1, intervals cover the true mean in 93 to 98 % of simulations; at 1.35, in 90 to 93 %."
    sections = {"Runs": rows}
    published = {key: n for key, n in wanted.lines.items() if key.sample_set == PAPER} if wanted.published else {}
    for key, cells in marked_cells(published).items():
        heading = f"Published on {benchmark_words(key.benchmark)}: {SETTING_LABELS[key.setting]}"
        values = [cells[of].marked if of in cells else None for of in keys]
        sections.setdefault(heading, []).append(Row(key.model, [*values, None], result=key))
    remarks += [about] * any(_spread(numbers) is not None for numbers in lines.values())
    remarks += ["†: not printed in the paper, from the EPE."] * wanted.published
    title = "Means with intervals" if any(known) else "Means"
    return [Table.of("means", title, (*MEANS, "sd(ln)"), sections, remarks)]


def _spread(numbers: Numbers) -> float | None:
    error = numbers.get((LEADING, AVERAGE, None), numbers.get(("rcre", AVERAGE, None)))
    return None if error is None else error["log_deviation"]


_CONFIDENCE_REMARK = (
    "AUSE: area between the sparsification curve and the oracle's; 0 if the least confident pixels have the largest "
    "errors. Normalised: divided by the error of each image. Error at 80 %: error of the 80 % most confident pixels. "
    "Spearman: rank correlation of confidence and error; -1 is best. Rejected: share of pixels rejected by the "
    "forward-backward check of Sundaram et al. 2010."
)
_CONFIDENCE = [
    Column(metric_label(name), key=(name, None))
    for name in CONFIDENCE
    if "_at_" not in name or name in ("error_at_80", "error_at_50")
]
_CONDITIONS = {CLEAN: "Clean", AVERAGE: "All corruptions"} | FAMILY_LABELS


def confidence_table(numbers: Numbers, source: str = "") -> Table | None:
    """Tabulate the confidence scores of a run by corruption family and by severity; return None if it has none."""
    known = {(of, at) for name, of, at in numbers if name in CONFIDENCE}
    if not known:
        return None
    wholes: dict[str, Condition] = {label: (name, None) for name, label in _CONDITIONS.items()}
    levels: dict[str, Condition] = {f"{FAMILY_LABELS[of]} {at}": (of, at) for of in MEMBERS for at in SEVERITIES}
    sections = {
        title: condition_rows(numbers, _CONFIDENCE, {label: at for label, at in rows.items() if at in known})
        for title, rows in {"Means": wholes, "By severity": levels}.items()
    }
    title = f"Confidence ({source})" if source else "Confidence"
    return Table.of("confidence", title, _CONFIDENCE, sections, [_CONFIDENCE_REMARK], "Corruptions")


_UNCOUPLED = (
    Column("clean EPE (px)", key=(LEADING, CLEAN, None)),
    Column("CRE (px)", key=("cre", AVERAGE, None)),
    *(Column(metric_label(name), key=(name, AVERAGE, None)) for name in UNCOUPLED),
    Column("rank correlation", key=("rank_correlation", AVERAGE, None)),
    Column("given the motion", key=("rank_correlation_given_motion", AVERAGE, None)),
)
_UNCOUPLED_REMARK = (
    "log ratio: ln(EPE / clean EPE), averaged over images; 0.69 if errors double. Medians are over images. "
    "Fl increase: percentage points of Fl-all. Rank correlation: between corrupted and clean EPE over images, first "
    "uncontrolled, then controlled for the true flow magnitude. CRE is EPE - clean EPE, so it depends on accuracy."
)


def uncoupled(wanted: Wanted) -> list[Table]:
    """Tabulate the measures that depend less on accuracy than CRE. With five or more ranked models on the same frames,
    add the rank correlations of CRE and log ratio with the clean EPE."""
    every = wanted.of_runs("uncoupled", "uncoupled")
    needed = ("log_ratio", "median_cre")
    lines = {key: n for key, n in every.items() if any((name, AVERAGE, None) in n for name in needed)}
    if not lines:
        raise UsageError("--table", "'uncoupled' needs ground truth, which none of these runs has")
    remarks = [_UNCOUPLED_REMARK]
    for of_set in by_sample_set(ranked(lines)).values():
        each = [[n.number(*column.key) for column in _UNCOUPLED[:3]] for n in of_set.values()]
        models = [values for values in each if None not in values]
        if len(models) >= LEAST_MODELS:
            accuracy, *others = map(list, zip(*models, strict=True))
            of_cre, of_ratio = (number_text(spearman(accuracy, one), "{:+.2f}") for one in others)
            remarks.append(
                f"Rank correlation with the clean EPE over {len(models)} models: CRE {of_cre}, log ratio {of_ratio}."
            )
    remarks.append(left_out_remark(every))
    rows = {"Runs": model_rows(lines, _UNCOUPLED)}
    return [Table.of("uncoupled", "Robustness beside accuracy", _UNCOUPLED, rows, remarks)]


def left_out_remark(lines: Lines) -> str:
    """Return the remark that names the runs omitted from statements about models in general; "" if there are none."""
    reasons = not_ranked({key.model: numbers.fact("excluded") for key, numbers in lines.items()})
    return f"Left out of trends and correlations: {'; '.join(reasons)}." if reasons else ""


def effective(wanted: Wanted) -> list[Table]:
    """Tabulate the effective robustness for each set of comparable results with enough models."""
    tables: list[Table] = []
    reason = UsageError("there are no results")
    for sample_set, lines in by_sample_set(without_seeds(wanted.lines)).items():
        part = ranked(lines)
        if not any((LEADING, AVERAGE, None) in n or ("rcre", AVERAGE, None) in n for n in part.values()):
            continue
        try:
            settings = effective_robustness(part)
        except UsageError as error:
            reason = error
            continue
        models = first_of([plain(name) for name in dict.fromkeys(key.model for key in part)], _MOST_NAMED)
        benchmark = next(iter(part)).benchmark
        whose = "published models" if sample_set == PAPER else on_benchmark(models, benchmark)
        sections = {
            SETTING_LABELS.get(setting, setting): [
                Row(key.model, values, full_note(part[key]), result=key) for key, values in of_setting.items()
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
