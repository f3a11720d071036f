"""Tables that the paper does not have: means with intervals, effective robustness, error breakdown, observations.
Table that compares 2D corruptions with their 3D counterparts.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..core.errors import RunError, UsageError
from ..core.text import counted, plain
from ..run.run import Run
from ..stats.anatomy import error_parts, severity_slopes
from ..stats.conditions import SeedGroup
from ..stats.effective import effective_robustness
from ..stats.flat_and_depth import TwinComparison, TwinErrors, twin_comparisons
from ..stats.model_result import ModelResult
from ..stats.ranking import LEAST_MODELS
from ..stats.results import METRIC_LABELS, SETTING_LABELS, long_label
from ..stats.run_results import named_runs
from ..stats.uncertainty import intervals
from ..stats.uncertainty.bootstrap import LEVEL, fewest_clusters
from ..stats.uncertainty.sums import AVERAGE
from .table import (
    DASH,
    Column,
    Line,
    Section,
    Table,
    differences_remark,
    full_note,
    interval_text,
    number_text,
    seed_line,
)
from .tables import MEANS


def means_table(results: Sequence[ModelResult], *, seed: int = 0, seeds: Sequence[SeedGroup] = ()) -> Table:
    """Tabulate the overall means of runs with confidence intervals, such as "3.21 [2.50, 4.10]", and the standard
    deviation of ln EPE (of ln RCRE without ground truth), on which the coverage of the intervals depends. The interval
    is omitted, with a remark, if there are too few images to compute it. For each group in `seeds`, a row with the mean
    and standard deviation follows the group's last run."""
    lines, known = [], []
    values: dict[tuple[str, str], list[float | None]] = {}
    for line in results:
        if line.run is None:
            continue
        rows = intervals(line.run.rows, seed=seed).to_dicts()
        estimates = {(row["metric"], row["corruption"]): row for row in rows}
        spread = estimates.get(("epe", AVERAGE), estimates.get(("rcre", AVERAGE), {})).get("log_deviation")
        cells = (*(_estimate(estimates.get(key)) for key in MEANS), number_text(spread))
        lines.append(Line.of(line.name, cells, full_note(line)))
        known += [row["low"] is not None for row in rows if (row["metric"], row["corruption"]) in MEANS]
        values[line.key] = [*(estimates[key]["estimate"] if key in estimates else None for key in MEANS), spread]
        lines += [seed_line(group, values) for group in seeds if group.runs[-1] == line.key]
    needed = f"{fewest_clusters()} images (or sequences, if pairs belong to sequences)"
    remark = f"No intervals, because they require at least {needed}."
    if any(known):
        remark = (
            f"[{100 * LEVEL:g} % confidence interval] from a bootstrap over images, or over sequences if pairs belong "
            "to sequences."
        )
        if not all(known):
            remark += f" Means without an interval are over fewer than {needed}, or one of these decides the mean."
    about = "sd(ln): standard deviation of ln EPE (ln RCRE without ground truth) over images or sequences."
    if any(known):
        about += " Up to 1.35, intervals cover the true mean in 89 to 98 % of simulations; above, perhaps in fewer."
    title = "Means with intervals" if any(known) else "Means"
    columns = tuple(map(Column, (*MEANS.values(), "sd(ln)")))
    return Table("means", title, columns, (Section("Runs", tuple(lines)),), (remark, about))


def effective_table(results: Sequence[ModelResult]) -> Table:
    """Tabulate `effective_robustness` for each set of comparable results."""
    columns = tuple(map(Column, ("clean EPE", "EPE", "expected EPE", "factor")))
    sections = []
    for setting, models in effective_robustness(results).items():
        lines = [
            Line.of_numbers(one.line.name, (one.clean, one.corrupted, one.expected, one.factor), full_note(one.line))
            for one in models
        ]
        sections.append(Section(SETTING_LABELS.get(setting, setting), tuple(lines)))
    remark = (
        "factor: EPE divided by the EPE predicted from the clean EPE by a fit to the other models; a value below 1 "
        "means more robust than expected from accuracy."
    )
    return Table("effective", "Effective robustness", columns, tuple(sections), (remark,))


def anatomy_table(runs: Sequence[Run]) -> Table:
    """Tabulate the error of each run by image region and corruption family, and its slope over severities."""
    columns = tuple(map(Column, ("share %", "adds (px)", "CRE (px)", "CREr", "RCRE (px)", "broken %", "slope (px)")))
    sections = []
    named = named_runs(runs)
    for name, run in named.items():
        lines = []
        for part in error_parts(run.averages):
            numbers = (part.share, part.contribution, part.cre, part.crer, part.rcre, part.broken, None)
            lines.append(Line.of_numbers(part.label, numbers))
        for corruption, slope in severity_slopes(run.averages, "rcre").items():
            lines.append(Line.of_numbers(long_label(corruption), [None] * 6 + [slope]))
        sections.append(Section(name, tuple(lines)))
    explained = (
        "share: share of the pixels; adds: contribution of a family to the mean CRE, negative if it reduces the mean; "
        "broken: net share of pixels that became Fl outliers; slope: RCRE per severity step."
    )
    remarks = (explained, *differences_remark(named))
    return Table("anatomy", "Anatomy of error", columns, tuple(sections), remarks, "Part")


def _estimate(row: dict[str, float | None] | None) -> str:
    if row is None:
        return "-"
    ends = None if row["low"] is None or row["high"] is None else (row["low"], row["high"])
    return f"{number_text(row['estimate'])} {interval_text(ends)}".rstrip()


FLAT_AND_DEPTH = "flat-and-depth"


def depth_table(runs: Sequence[Run], seed: int = 0) -> Table:
    """Tabulate rank correlations over models, and each model's differences, between 2D corruptions and their 3D
    counterparts.
    """
    try:
        found = twin_comparisons(runs, seed)
    except RunError as error:
        raise UsageError(str(error)) from error
    if not found:
        raise UsageError(
            f"the table '{FLAT_AND_DEPTH}' needs runs with a corruption and its 3D counterpart, for example "
            "--corruptions fog,fog_3d"
        )
    label = METRIC_LABELS[found[0].metric]
    columns = tuple(map(Column, ("flat (px)", "in depth (px)", "value", "95 % low", "95 % high")))
    remarks = [
        f"{label} under a 2D corruption and its 3D counterpart, on the same pairs and severities. Value: Spearman's "
        "rank correlation over models with an interval by Fisher's z; for a single model, the difference 3D minus 2D "
        "in px with an interval over pairs or groups of pairs. Correlations exclude models that are not ranked."
    ]
    if any(one.count < LEAST_MODELS for one in found):
        remarks.append(f"No correlation is computed for fewer than {LEAST_MODELS} models.")
    remarks += dict.fromkeys(one.remark for one in found if one.remark)
    sections = [Section("Rank correlation over models", tuple(map(_correlation_line, found)))]
    sections += [Section(_title(one), tuple(_model_line(model) for model in one.models)) for one in found]
    title = "Do 2D corruptions predict 3D corruptions?"
    return Table(FLAT_AND_DEPTH, title, columns, tuple(sections), tuple(remarks), "Corruptions, model")


def _title(one: TwinComparison) -> str:
    return f"{one.flat} and {one.deep}, severities {', '.join(map(str, one.severities))}"


def _correlation_line(one: TwinComparison) -> Line:
    low, high = one.interval or (None, None)
    texts = [DASH if value is None else f"{value:+.2f}" for value in (one.rho, low, high)]
    few = f"{counted(one.count, 'ranked model')}: too few for a correlation" if one.count < LEAST_MODELS else ""
    return Line.of(f"{one.flat}, {one.deep} ({counted(one.count, 'model')})", (DASH, DASH, *texts), few)


def _model_line(model: TwinErrors) -> Line:
    difference = model.difference
    values = (model.flat, model.deep, difference.estimate, difference.low, difference.high)
    return Line.of(plain(model.model), tuple(number_text(value, 2) for value in values), model.excluded)
