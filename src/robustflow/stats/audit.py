"""Check published results, or your own, for consistency, and list each inconsistency with both numbers; printed numbers
are compared up to rounding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import polars as pl

from ..core.types import Frozen, FrozenFinite
from ..corruptions.registry import PAPER_ORDER
from .frame import LINE, line_by_line
from .lines import RANKS, lines_of
from .published.tables import cost_ranks, published_frame
from .results import AVERAGE, CLEAN, LABELS, METRIC_LABELS

AUDIT_CHECKS = {
    "cre": "CRE is the corrupted minus the clean EPE",
    "crer": "CREr is CRE / clean EPE, with the CRE computed from the EPE",
    "crer_from_cre": "CREr is CRE / clean EPE, with the printed CRE",
    "average": "the average is the mean over corruptions",
    "bound": "RCRE is at least |EPE - clean EPE|",
    "best": "the best value in each column is marked",
    "rank": "ranks follow from the printed values",
    "rank_from_epe": "ranks follow from CREr computed from the EPE",
    "swapped": "each row belongs to its model",
    "shifted": "each value is in the right column",
}
"""Statement verified by each check."""


class Finding(FrozenFinite):
    """A number that differs from the value computed from other numbers by more than rounding can explain."""

    check: str
    source: str
    setting: str = ""
    model: str = ""
    metric: str = ""
    corruption: str = ""
    given: float | None = None
    recomputed: float | None = None
    tolerance: float | None = None
    message: str


class Audit(Frozen):
    """All findings, and the number of values that each check compared."""

    audited: str
    checked: dict[str, int]
    findings: list[Finding]

    @property
    def fits(self) -> bool:
        """Whether all numbers are consistent within rounding."""
        return not self.findings


_GROUP = ("benchmark", "sample_set", "setting")
_PATTERN = 3
"""Minimum number of matching values for a pattern."""
_FLOAT = 1e-9
"""Tolerance for floating-point error, so that 0.1 + 0.2 matches 0.3, and the rounding of an unrounded number."""

Part = tuple[str, int, list[Finding]]
"""A check, the number of values that it compared, and its findings."""


def audit_published() -> Audit:
    """Audit the paper's tables."""
    return audit_results(published_frame(), audited="the published tables")


def audit_results(frame: pl.DataFrame, audited: str = "results") -> Audit:
    """Audit the numbers of a results frame from any source."""
    cells = _cells(frame)
    change = _changes(cells)
    cre, rcre = (_compared(change, cells, metric, LINE) for metric in ("cre", "rcre"))
    crer, printed = (_ratios(change, cells, made_of) for made_of in ("EPE", "CRE"))
    ratio = "CREr {given:.2f}, but its {made_of} and clean EPE imply {recomputed:.3f}"
    parts = [
        _swapped(change, cells, cre),
        _shifted(cre),
        _values("cre", cre, "CRE {given:.2f}, but EPE - clean EPE = {recomputed:.2f}"),
        _averages(cells),
        _values("crer", crer, ratio),
        _values("crer_from_cre", printed, ratio),
        _values(
            "bound", rcre, "RCRE {given:.2f} is less than |EPE - clean EPE| = {recomputed:.2f}, which is impossible"
        ),
        _marks(cells),
        *_ranks(frame, crer),
    ]
    return Audit(
        audited=audited,
        checked={check: count for check, count, _ in parts if count},
        findings=[finding for _, _, findings in parts for finding in findings],
    )


def _cells(frame: pl.DataFrame) -> pl.DataFrame:
    """Return the given numbers line by line, with `half`, half a unit of the last printed digit, and `partly`, whether
    the errors of the line are not over all pixels."""
    units = {decimals: 0.5 * 10.0**-decimals for decimals in frame["decimals"].drop_nulls().unique()}
    unrounded = _FLOAT * pl.col("value").abs().clip(1.0)
    half = pl.col("decimals").replace_strict(units, default=None, return_dtype=pl.Float64).fill_null(unrounded)
    partly = (pl.col("coverage") < 1).any().over(LINE)
    columns = (*LINE, "measure", "condition", "origin", "value", "marked", "source")
    return line_by_line(frame).select(*columns, half=half, partly=partly)


def _changes(cells: pl.DataFrame) -> pl.DataFrame:
    """Return EPE - clean EPE of each line under each corruption and the average, with the rounding error."""
    epe = cells.filter(~pl.col("partly"), measure="epe")
    clean = epe.filter(condition=CLEAN).select(*LINE, clean="value", clean_half="half")
    both = epe.filter(pl.col("condition") != CLEAN).join(clean, on=LINE, maintain_order="left")
    return both.select(
        *LINE,
        *("condition", "clean", "clean_half"),
        epe_origin="origin",
        expected=pl.col("value") - pl.col("clean"),
        rounding=pl.col("half") + pl.col("clean_half"),
    )


def _compared(change: pl.DataFrame, cells: pl.DataFrame, metric: str, on: Sequence[str]) -> pl.DataFrame:
    """Compare a metric with the change in EPE: a CRE has to be equal to it, an RCRE at least as large. With `on` less
    than a line, the values of every line are compared with the change of every line that has these columns."""
    given = cells.filter(measure=metric).rename({"value": "given"})
    both = change.join(given, on=[*on, "condition"], maintain_order="left_right")
    recomputed = pl.col("expected").abs() if metric == "rcre" else pl.col("expected")
    both = both.with_columns(recomputed=recomputed, tolerance=pl.col("rounding") + pl.col("half"))
    possible = pl.col("given") >= pl.col("recomputed") if metric == "rcre" else pl.lit(False)
    return both.with_columns(misfit=~possible & _misfits())


def _misfits(given: str = "given") -> pl.Expr:
    """Whether a difference is too large to be explained by rounding."""
    least = pl.col("tolerance") + _FLOAT * pl.col(given).abs().clip(1.0)
    return (pl.col(given) - pl.col("recomputed")).abs() > least


def _ratios(change: pl.DataFrame, cells: pl.DataFrame, made_of: str) -> pl.DataFrame:
    """Compare each CREr with the ratio of the change in EPE, or of the paper's CRE, to the clean EPE."""
    clean, clean_half = pl.col("clean"), pl.col("clean_half")
    given = cells.filter(measure="crer").rename({"value": "given"})
    both = change.join(given, on=[*LINE, "condition"], maintain_order="left").filter(clean > clean_half)
    top, error = pl.col("expected"), pl.col("rounding")
    if made_of == "CRE":
        cre = cells.filter(measure="cre", source="published").select(*LINE, "condition", cre="value", cre_half="half")
        both = both.join(cre, on=[*LINE, "condition"], maintain_order="left")
        top, error = pl.col("cre"), pl.col("cre_half")
    ends = [(top + a * error) / (clean + b * clean_half) for a in (-1, 1) for b in (-1, 1)]
    ratio = top / clean
    reach = pl.max_horizontal(pl.max_horizontal(ends) - ratio, ratio - pl.min_horizontal(ends))
    both = both.with_columns(recomputed=ratio, tolerance=pl.col("half") + reach, made_of=pl.lit(made_of))
    return both.with_columns(misfit=_misfits())


def _averages(cells: pl.DataFrame) -> Part:
    """Check that the average of each metric is the mean over all corruptions of its line, or over the paper's. If some
    corruptions have an EPE, those without one leave no ground truth, and averages do not include them."""
    single = pl.col("condition").is_in([CLEAN, AVERAGE]).not_()
    parts = cells.filter(single, pl.col("measure").is_in(list(METRIC_LABELS)))
    errors = parts.filter(measure="epe").select(*LINE, "condition", error=pl.lit(True))
    parts = parts.join(errors, on=[*LINE, "condition"], how="left", maintain_order="left")
    parts = parts.filter(pl.col("error").any().over(LINE).not_() | pl.col("error"))
    papers = pl.col("condition").is_in(PAPER_ORDER)
    means = parts.group_by(*LINE, "measure").agg(
        recomputed=pl.col("value").mean(),
        spread=pl.col("half").mean(),
        papers=pl.col("value").filter(papers).mean(),
        papers_spread=pl.col("half").filter(papers).mean(),
        count=pl.len(),
    )
    given = cells.filter(condition=AVERAGE).rename({"value": "given"})
    table = given.join(means, on=[*LINE, "measure"], maintain_order="left")
    table = table.with_columns(tolerance=pl.col("half") + pl.col("spread"), misfit=pl.lit(True))
    table = table.with_columns(misfit=_misfits())
    papers_mean = table.with_columns(recomputed="papers", tolerance=pl.col("half") + pl.col("papers_spread"))
    table = table.with_columns(misfit=pl.col("misfit") & papers_mean.select(_misfits().fill_null(True)).to_series())
    return _values(
        "average", table, "{label} {given:.2f}, but the mean over its corruptions ({count}) is {recomputed:.3f}"
    )


def _marks(cells: pl.DataFrame) -> Part:
    """Check that, among the models of one setting, exactly the smallest number in each column is marked."""
    column = [*_GROUP, "measure", "condition"]
    table = (
        cells.drop_nulls("marked").filter(pl.col("marked").any().over(*_GROUP, "measure")).rename({"value": "given"})
    )
    table = table.with_columns(recomputed=pl.col("given").min().over(column), tolerance=0.0)
    least = pl.col("given") == pl.col("recomputed")
    best = pl.col("model").filter(least).str.join(" and ").over(column)
    table = table.with_columns(best=best, misfit=(least != pl.col("marked")).any().over(column))
    table = table.sort("marked", descending=True, maintain_order=True).unique(column, keep="first", maintain_order=True)
    return _values(
        "best", table, "{label} {given:.2f} is marked as best or nothing is, but {best} has {recomputed:.2f}"
    )


def _swapped(change: pl.DataFrame, cells: pl.DataFrame, cre: pl.DataFrame) -> Part:
    """Find pairs of models in the same setting whose rows match each other's EPE but not their own."""
    crossed = {metric: _compared(change, cells, metric, _GROUP) for metric in ("cre", "rcre")}
    wrong = cre.filter(pl.col("misfit").sum().over(LINE) >= _PATTERN).unique(LINE, keep="first", maintain_order=True)
    wrong = wrong.select(*LINE).with_row_index("at")
    pairs = wrong.join(wrong, on=_GROUP, maintain_order="left_right").filter(pl.col("at") < pl.col("at_right"))
    findings = []
    for *group, first, second in pairs.select(*_GROUP, "model", "model_right").iter_rows():
        of_group = dict(zip(_GROUP, group, strict=True))
        for metric, table in crossed.items():
            both = pl.col("model", "model_right").is_in([first, second])
            misfits = table.filter("misfit", pl.all_horizontal(both), **of_group)
            own = misfits.filter(pl.col("model") == pl.col("model_right"))
            if own.is_empty() or own.height < misfits.height:
                break
            text = f"{metric.upper()} rows of {first} and {second} are swapped: {own.height} values do not match"
            place = own.row(0, named=True) | {"model": first, "condition": ""}
            findings.append(_finding("swapped", place, f"{text} their own EPE rows, but all match the other's"))
    return "swapped", pairs.height, findings


def _shifted(cre: pl.DataFrame) -> Part:
    """Find consecutive values of a model that match the neighbouring column but not their own."""
    own, findings = cre.filter(pl.col("condition") != AVERAGE), []
    for step, side in ((-1, "right"), (1, "left")):
        table = own.with_columns(beside=pl.col("given").shift(step).over(LINE))
        table = table.with_columns(fits=(pl.col("misfit") & ~_misfits("beside")).fill_null(False))
        table = table.with_columns(run=pl.col("fits").rle_id().over(LINE)).filter("fits")
        for _, run in table.group_by(*LINE, "run", maintain_order=True):
            if run.height >= _PATTERN:
                names, row = ", ".join(run["condition"]), run.row(0, named=True)
                text = f"EPE - clean EPE for {names} equals the CRE one column to the {side}, not in the same column"
                findings.append(_finding("shifted", row | {"measure": "epe", "origin": row["epe_origin"]}, text))
    return "shifted", 2 * own.height - own.select(LINE).n_unique(), findings


def _ranks(frame: pl.DataFrame, crer: pl.DataFrame) -> list[Part]:
    """Check the ranks of Tab. 3 against its values, also with inconsistent CREr recomputed from the EPE."""
    names = {measure: name for name, (measure, *_) in RANKS.items()}
    printed = frame.filter(pl.col("measure").is_in(list(names))).rename({"value": "given"})
    # the FLOPs have one rank in all settings; printed CREr have two decimals
    printed = printed.filter((pl.col("measure") != "flops_rank") | pl.struct("measure", "model").is_first_distinct())
    wrong = crer.filter("misfit", condition=AVERAGE).select("setting", "model", "recomputed").iter_rows()
    corrected = {(setting, model): round(ratio, 2) for setting, model, ratio in wrong}
    parts, lines = [], lines_of(frame)
    for check, ranks in (("rank", cost_ranks(lines)), ("rank_from_epe", cost_ranks(lines, corrected))):
        right = [ranks[names[row["measure"]], row["setting"]][row["model"]] for row in printed.to_dicts()]
        table = printed.with_columns(recomputed=pl.Series(right, dtype=pl.Float64), tolerance=0.0)
        table = table.with_columns(misfit=pl.col("given") != pl.col("recomputed"), condition=pl.lit(AVERAGE))
        parts.append(_values(check, table, "{measure} {given:.0f}, but {recomputed:.0f} follows from the values"))
    return parts


def _values(check: str, table: pl.DataFrame, template: str) -> Part:
    """Return a finding for each row that does not fit."""
    found = []
    for row in table.filter("misfit").iter_rows(named=True):
        text = template.format(label=LABELS.get(row["measure"]), **row)
        found.append(_finding(check, row, text, *(row[name] for name in ("given", "recomputed", "tolerance"))))
    return check, table.height, found


def _finding(check: str, row: Mapping[str, Any], text: str, *numbers: float) -> Finding:
    place = f"{row['setting']} {row['model']}, {row['condition']}"
    return Finding(
        check=check,
        source=row["origin"],
        setting=row["setting"],
        model=row["model"],
        metric=row["measure"],
        corruption=row["condition"],
        message=f"{place if row['condition'] else row['setting']}: {text}",
        **dict(zip(("given", "recomputed", "tolerance"), numbers, strict=False)),
    )
