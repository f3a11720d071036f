"""The results frame: every number of runs, of the paper and of results files as one table, of which tables, figures
and exports show a part."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import polars as pl

from ..core.errors import DataError
from ..core.text import plain
from ..metrics.cube import AVERAGE, PAPER
from ..metrics.measures import LEADING, MEASURES
from ..metrics.regions import REGIONS
from ..metrics.rows import CLEAN
from ..run.comparable import named_runs, sample_set
from ..run.run import Run
from .estimate import CONTRASTS, ESTIMATES, OVERALL_SCOPES, contrast, cubes_of
from .exclusion import exclusions
from .intervals import ESTIMATED, estimates_of, paper_rows
from .notes import comparison_notes
from .numbers import NUMBERS, covered, run_means
from .results import NEVER_RANKED, RESULT_METRICS
from .verdict import compared, verdict_of

RESULTS_SCHEMA: dict[str, Any] = {
    **dict.fromkeys(("benchmark", "model", "sample_set", "setting", "measure", "condition"), pl.String),
    "severity": pl.Int64,
    "against": pl.String,
    **{name: kind for name, kind in (ESTIMATES | CONTRASTS).items() if name != "left_out"},
    "letter": pl.String,
    "deviation": pl.Float64,
    **dict.fromkeys(("source", "note", "excluded", "origin"), pl.String),
    "coverage": pl.Float64,
    "decimals": pl.Int64,
    "marked": pl.Boolean,
}
"""`condition` is "clean", "average" (over corruptions), "paper" (over exactly the paper's corruptions), a family, a
corruption, a region of the image, or an attack; `severity` is null for a mean over severities. `low` and `high` are the
ends of the 95 % interval, where one was computed. A row with `against` is the difference from that model (see
`estimate.CONTRASTS`), with the p-values and the number of images on which `model` is better; models that share a
`letter` of the group cannot be told apart. Models of one `sample_set` measured the same frames and may be
compared. `source` is "measured", "verified record", "published", "claimed" (by a results file without rows) or "seeds"
(a mean over runs, with their standard `deviation`). `note` says what was measured, `coverage` is the share of the
pixels that the errors include (null for all), and `excluded` the reason why the model is not ranked (""). Of one
number, `origin` is the table or the run that it is from, `decimals` the number of its printed decimals (null if it was
not rounded), and `marked` whether its source sets it in bold (null if that marks nothing)."""

LINE = ("benchmark", "sample_set", "setting", "model")
"""The columns that a line of a results table has in common."""
MEASURED = ("measured", "verified record")
"""The sources of runs."""
DERIVED = "other values of the line"
"""The origin of a number that its line does not give, but that follows from its other numbers."""

KINDS = ("means", "confidence", "uncoupled", "attacks")
"""Parts of the frame of each run: the means of `robustflow.metrics.MEASURES`, and the measures of confidence, of
robustness beside accuracy, and of attacks. "facts" are the cost of the model and what a run lacks."""
CONTRAST, VERDICT = "contrasts", "verdicts"
"""Parts of the frame with paired tests and group letters: of every two runs of a sample set in every measure, or only
the tests that decide who leads within a setting."""
MOST_COMPARED = 20
"""Maximum number of models of a setting that are tested against each other and have a group letter."""
ERRORS = (("epe", AVERAGE), ("rcre", AVERAGE), ("epe", CLEAN))
"""The error by which models are sorted: the EPE under corruption, or the RCRE without ground truth. Sorting by CRE
would put the knowledge-driven methods first because their clean error is already high."""


def results_frame(
    runs: Sequence[Run],
    kinds: Collection[str] = KINDS,
    *,
    intervals: bool = True,
    detailed: bool = True,
    beside_published: bool = False,
    notes: Sequence[str] | None = None,
) -> pl.DataFrame:
    """Return the numbers of runs, one per row (`RESULTS_SCHEMA`); what was not measured has no row. Computing intervals
    takes about a second for each run that has not stored them; unless `detailed`, only averages have one. With
    `beside_published`, averages are over the paper's corruptions where all of them were run."""
    parts, named = [pl.DataFrame(schema=RESULTS_SCHEMA)], named_runs(runs)
    notes = notes or comparison_notes(runs, beside_published)
    reasons = exclusions(runs)
    letters, tests = _compared(named, reasons, kinds, beside_published)
    for (name, run), note, excluded in zip(named.items(), notes, reasons, strict=True):
        rows = [row for kind in kinds if kind in NUMBERS for row in NUMBERS[kind](run, beside_published)]
        part = pl.DataFrame(rows, _NUMBER)
        if intervals and "means" in kinds:
            known = pl.DataFrame(estimates_of(run, detailed, beside_published), _ESTIMATED, orient="row")
            part = part.join(known, on=ESTIMATED[:3], how="left", nulls_equal=True, maintain_order="left")
            part = part.with_columns(pl.coalesce(end, f"{end}_right").alias(end) for end in ("low", "high"))
            part = part.drop("low_right", "high_right")
        led = (pl.col("measure") == LEADING) & (pl.col("condition") == AVERAGE) & pl.col("severity").is_null()
        part = part.with_columns(letter=pl.when(led).then(pl.lit(letters.get(name), pl.String)))
        part = pl.concat([part, tests.filter(model=name).drop("model", "left_out")], how="diagonal")
        facts = {
            "benchmark": run.benchmark,
            "model": name,
            "sample_set": sample_set(run),
            "setting": run.setting,
            "source": "verified record" if run.record else "measured",
            "note": note,
            "coverage": covered(run),
            "excluded": excluded,
            "origin": run.manifest.identity_digest,
        }
        typed = {column: pl.lit(fact, RESULTS_SCHEMA[column]) for column, fact in facts.items()}
        parts.append(part.with_columns(pl.col("pairs").fill_null(run.measured.samples), **typed))
    return pl.concat(parts, how="diagonal")


_NUMBER = {
    name: RESULTS_SCHEMA[name]
    for name in ("measure", "condition", "severity", "value", "low", "high", "pairs", "decimals")
}
_ESTIMATED = {name: RESULTS_SCHEMA[name] for name in ESTIMATED}


def _compared(
    named: Mapping[str, Run], reasons: Sequence[str], kinds: Collection[str], beside_published: bool
) -> tuple[dict[str, str], pl.DataFrame]:
    """Return the group letter of each ranked run within its setting, and the tests of runs of a sample set on the clean
    frames and on average, each corrected for all pairs that are tested together."""
    letters, tests = dict[str, str](), [pl.DataFrame(schema=CONTRASTS)]
    of_set: dict[str, list[str]] = {}
    for name, run in named.items() if {CONTRAST, VERDICT} & {*kinds} else ():
        of_set.setdefault(sample_set(run), []).append(name)
    rank = {name: _error(run, beside_published) for name, run in named.items()} if of_set else {}
    excluded = dict(zip(named, reasons, strict=True))

    def rows(names: Iterable[str]) -> dict[str, pl.DataFrame]:
        return {name: paper_rows(named[name]) if beside_published else named[name].rows for name in names}

    for names in of_set.values():
        if CONTRAST in kinds and len(names) > 1:
            cubes = cubes_of(rows(names))
            tests += [contrast(cubes, MEASURES, [scope]) for scope in OVERALL_SCOPES]
        of_setting: dict[str, list[str]] = {}
        for name in sorted(names, key=lambda name: (rank[name], name)):
            if not excluded[name] and rank[name] is not None:
                of_setting.setdefault(named[name].setting, []).append(name)
        together = [best[:MOST_COMPARED] for best in of_setting.values() if len(best) > 1]
        for best in together:
            found = compared(rows(best), explained=False)
            letters |= verdict_of(found).letters
            tests += [found] * (VERDICT in kinds)
        if VERDICT in kinds and not together and len(of_setting) > 1:  # the lowest two, of different settings
            two = [best[0] for best in of_setting.values()][:2]
            tests.append(compared(rows(two), explained=False))
    return letters, pl.concat(tests, how="diagonal")


def _error(run: Run, beside_published: bool) -> float | None:
    means = run_means(run, beside_published)
    return next((value for key in ERRORS[:2] if (value := means.get((*key, None))) is not None), None)


def given_frame(rows: Iterable[dict[str, Any]], where: str = "") -> pl.DataFrame:
    """Return the results frame of numbers that are given as they are, without rows. Raise a DataError, with the name of
    the file, if one is given twice."""
    frame = pl.DataFrame(list(rows), schema=RESULTS_SCHEMA, orient="row")
    reasons = pl.col("setting").replace_strict(NEVER_RANKED, default="", return_dtype=pl.String)
    texts = pl.col("note", "origin").fill_null(""), pl.col("source").fill_null("claimed")
    return once(frame.with_columns(*texts, excluded=reasons), where)


def once(frame: pl.DataFrame, where: str = "") -> pl.DataFrame:
    """Return a frame in which no line has a number twice; raise a DataError otherwise."""
    repeated = frame.filter(frame.select(*LINE, "measure", "condition", "severity", "against").is_duplicated())
    for row in repeated.head(1).iter_rows(named=True):
        whose = f"'{plain(row['model'])}' ({plain(row['setting'])}, sample set '{plain(row['sample_set'])}')"
        message = f"{row['measure']} of {whose} on {row['condition']} appears twice; give each value only once"
        raise DataError(where or plain(row["model"]), message)
    return frame


def line_by_line(frame: pl.DataFrame) -> pl.DataFrame:
    """Return a frame with the numbers of each line together, in order of first appearance."""
    return frame.sort(pl.int_range(pl.len()).min().over(LINE), maintain_order=True)


def of_results(frame: pl.DataFrame) -> pl.DataFrame:
    """Return the rows that results files have: of runs, the clean EPE and the EPE, CRE, RCRE and CREr over severities;
    of others, all of these measures that they give."""
    error = (pl.col("condition") == CLEAN) & (pl.col("measure") == "epe")
    means = ~pl.col("condition").is_in([CLEAN, PAPER, *REGIONS])
    whole = pl.col("severity").is_null() & pl.col("against").is_null() & pl.col("measure").is_in(RESULT_METRICS)
    return frame.filter(whole & (error | means | ~pl.col("source").is_in(MEASURED)))
