"""The results frame: every number of runs, of the paper and of results files as one table, of which tables, figures
and exports show a part."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import polars as pl

from ..core.errors import DataError
from ..core.text import plain
from ..corruptions.registry import MEMBERS
from ..metrics.cube import AVERAGE, PAPER, Cube, MeanKey, Means
from ..metrics.measures import CONFIDENCE, LEADING, MEASURES, METRICS, UNCOUPLED
from ..metrics.rows import CLEAN
from ..run.comparable import named_runs, sample_set
from ..run.costs import RunCost
from ..run.run import Run
from .attacks import attack_scores
from .estimate import OVERALL_SCOPES, contrast, cubes_of
from .exclusion import exclusions
from .intervals import interval_ends
from .ranking import partial_spearman, spearman
from .results import NEVER_RANKED
from .run_results import comparison_notes
from .verdict import verdict_of

RESULTS_SCHEMA: dict[str, type[pl.DataType]] = {
    "benchmark": pl.String,
    "model": pl.String,
    "sample_set": pl.String,
    "setting": pl.String,
    "measure": pl.String,
    "condition": pl.String,
    "severity": pl.Int64,
    "against": pl.String,
    "value": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "p": pl.Float64,
    "p_adjusted": pl.Float64,
    "wins": pl.Int64,
    "letter": pl.String,
    "pairs": pl.Int64,
    "source": pl.String,
    "note": pl.String,
    "coverage": pl.Float64,
    "excluded": pl.String,
    "origin": pl.String,
    "decimals": pl.Int64,
    "marked": pl.Boolean,
}
"""`condition` is "clean", "average" (over corruptions), "paper" (over exactly the paper's corruptions), a family, a
corruption, a region of the image, or an attack; `severity` is null for a mean over severities. `low` and `high` are the
ends of the 95 % interval, where one was computed. A row with `against` is the difference from that model (see
`estimate.CONTRASTS`), with the p-values and the number of images on which `model` is better; models that share a
`letter` of the group cannot be told apart. Models of one `sample_set` measured the same frames and may be
compared. `source` is "measured", "verified record", "published" or "claimed" (by a results file without rows). `note`
says what was measured, `coverage` is the share of the pixels that the errors include (null for all), and `excluded` the
reason why the model is not ranked (""). Of one number, `origin` is the table or the run that it is from, `decimals` the
number of its printed decimals (null if it was not rounded), and `marked` whether its source sets it in bold (null if
that marks nothing)."""

LINE = ("benchmark", "sample_set", "setting", "model")
"""The columns that a line of a results table has in common."""

KINDS = ("means", "confidence", "uncoupled", "attacks")
"""Parts of the frame of each run: the means of `robustflow.metrics.MEASURES`, and the measures of confidence, of
robustness beside accuracy, and of attacks."""
CONTRAST = "contrasts"
"""The part of the frame with the paired tests of every two runs of a sample set, and the group letters."""

LEAST_IMAGES = 5
"""Minimum number of images for a correlation."""


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
    letters, tests = _contrasts(named, reasons) if CONTRAST in kinds else ({}, pl.DataFrame(schema=_TESTS))
    for (name, run), note, excluded in zip(named.items(), notes, reasons, strict=True):
        values = [(*key, value) for kind in kinds if kind != CONTRAST for key, value in _NUMBERS[kind](run).items()]
        part = pl.DataFrame(values, schema=_VALUES, orient="row")
        if beside_published and run.measured.paper_over:
            part = part.filter(pl.col("condition") != AVERAGE)
            part = part.with_columns(pl.col("condition").replace(PAPER, AVERAGE))
        wanted = intervals and "means" in kinds
        known = interval_ends(run, detailed, beside_published).items() if wanted else ()
        ends = pl.DataFrame([(*key, *pair) for key, pair in known], schema=_ENDS, orient="row")
        ends = ends.with_columns(severity=pl.lit(None, pl.Int64))
        part = part.join(ends, on=["measure", "condition", "severity"], how="left", nulls_equal=True)
        led = (pl.col("measure") == LEADING) & (pl.col("condition") == AVERAGE) & pl.col("severity").is_null()
        part = part.with_columns(letter=pl.when(led).then(pl.lit(letters.get(name), pl.String)))
        part = pl.concat([part, tests.filter(model=name).drop("model")], how="diagonal")
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
        pairs = pl.col("pairs").fill_null(run.measured.samples)
        parts.append(part.with_columns(pairs, **typed))
    return pl.concat(parts, how="diagonal")


def _contrasts(named: Mapping[str, Run], reasons: Sequence[str]) -> tuple[dict[str, str], pl.DataFrame]:
    """Return the group letter of each ranked run within its setting, and the tests of every two runs of a sample set on
    the clean frames and on average, each corrected for all pairs."""
    rows: dict[str, dict[str, pl.DataFrame]] = {}
    ranked: dict[tuple[str, str], dict[str, pl.DataFrame]] = {}
    for (name, run), reason in zip(named.items(), reasons, strict=True):
        rows.setdefault(sample_set(run), {})[name] = run.rows
        if not reason:
            ranked.setdefault((sample_set(run), run.setting), {})[name] = run.rows
    letters: dict[str, str] = {}
    tests = [pl.DataFrame(schema=_TESTS)]
    for of_set in rows.values():
        if len(of_set) > 1:
            cubes = cubes_of(of_set)
            tests += [contrast(cubes, MEASURES, [scope]).select(_TESTS.keys()) for scope in OVERALL_SCOPES]
    for of_setting in ranked.values():
        letters |= verdict_of(of_setting).letters
    return letters, pl.concat(tests)


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


def covered(run: Run) -> float | None:
    """Return the fraction of pixels included in the errors; None for all pixels. Pixels without a predicted flow and
    planned rows that are missing are not included."""
    predicted = run.mean("coverage") if run.averages.has_gaps else None
    if not run.measured.missing:
        return predicted
    missing = sum(cells.count for cells in run.measured.missing)
    planned = sum(part.count(attacks=False) for part in run.manifest.planned)
    return (1.0 if predicted is None else predicted) * (1 - missing / planned)


_VALUES = {name: RESULTS_SCHEMA[name] for name in ("measure", "condition", "severity", "value")}
_TESTS = {
    name: RESULTS_SCHEMA[name]
    for name in ("model", *_VALUES, "against", "low", "high", "p", "p_adjusted", "wins", "pairs")
}
_ENDS = {name: RESULTS_SCHEMA[name] for name in ("measure", "condition", "low", "high")}


def confidence_means(rows: pl.DataFrame) -> Means:
    """Return how well the confidence predicts errors, also by family and severity; empty if the run has none."""
    known = rows.filter(pl.col("ause").is_not_null() | pl.col("rejected_count").is_not_null())
    return Cube.of(known, MEMBERS).means(CONFIDENCE) if known.height else {}


def uncoupled_means(rows: pl.DataFrame) -> Means:
    """Return measures of robustness that depend less on accuracy than CRE (`UNCOUPLED`), and the rank correlation over
    images of the corrupted and the clean EPE, also given the motion."""
    return Cube.of(rows, MEMBERS).means(UNCOUPLED) | dict(_correlations(rows))


def _correlations(rows: pl.DataFrame) -> Iterator[tuple[MeanKey, float]]:
    n = pl.col("n_valid")
    known = rows.filter(n > 0)
    images = known.filter(pl.col("corruption") != CLEAN).join(known.filter(corruption=CLEAN), on="sample", how="semi")
    for condition in (AVERAGE, *images["corruption"].unique().sort()):
        part = images if condition == AVERAGE else images.filter(corruption=condition)
        per_image = (pl.col(total) / n for total in ("epe_sum", "clean_epe_sum", "magnitude_sum"))
        each = part.group_by("sample", maintain_order=True).agg(value.mean() for value in per_image)
        if each.height < LEAST_IMAGES:
            continue
        epe, before, motion = (each[name].to_list() for name in each.columns[1:])
        found = {"rank_correlation": spearman(epe, before)}
        found["rank_correlation_given_motion"] = partial_spearman(epe, before, motion)
        yield from (((name, condition, None), value) for name, value in found.items() if value is not None)


def attack_means(run: Run) -> Means:
    """Return the numbers of `attack_scores`, with the prefix "attack_" except for the metrics, and the number of pairs
    with each warning as "warning KEY"."""
    out: dict[MeanKey, float] = {}
    for score in attack_scores(run):
        at = score["attack"], score["severity"]
        numbers: dict[str, Any] = {
            name if name in METRICS else f"attack_{name}": value
            for name, value in score.items()
            if isinstance(value, int | float) and name not in ("severity", "samples")
        }
        numbers |= {f"warning {key}": count for key, count in score["warnings"].items()}
        out |= {(name, *at): float(value) for name, value in numbers.items()}
    return out


def _facts(run: Run) -> Means:
    """Return the cost of the model, and `covered`."""
    cost, share = RunCost.read(run), covered(run)
    known: Means = {} if share is None else {("coverage", "", None): share}
    if cost is not None:
        known |= {("parameters", "", None): cost.parameters_m, ("flops", "", None): cost.flops_g}
    return known


_NUMBERS = {
    "means": lambda run: run.means,
    "confidence": lambda run: confidence_means(run.rows),
    "uncoupled": lambda run: uncoupled_means(run.rows),
    "attacks": attack_means,
    "facts": _facts,
}
