"""Compare our values with the published ones, in a table and in a file."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..core.arguments import SEVERITIES
from ..core.text import text_cell
from ..corruptions.registry import FAMILIES
from ..data.benchmarks import benchmark_facts
from ..metrics.error_maps import crer
from ..metrics.measures import exact_mean
from ..report.table import Column, Row, Table, run_frame
from ..run.run import Run
from ..stats.frame import DERIVED
from ..stats.lines import Numbers, lines_of
from ..stats.notes import comparison_note
from ..stats.published.tables import published_lines
from ..stats.results import (
    AVERAGE,
    CLEAN,
    FAMILY_LABELS,
    LABELS,
    OVERALL,
    RESULT_METRICS,
    SETTING_LABELS,
    family_crer,
    family_label,
    mean_label,
    short_label,
)
from .plan import Artefact, Runnable, Variant

MetricValues = Mapping[tuple[str, str], float]
"""Values of one variant by (metric, corruption), with ("crer", family) for the mean CREr of a family."""


@dataclass(frozen=True)
class SideBySide:
    """The published values of a variant and, if it was evaluated here, our values."""

    variant: Variant
    published: MetricValues
    here: MetricValues
    note: str = ""
    random: bool = False


def run_beside_paper(artefact: Artefact, runnable: Runnable, run: Run) -> SideBySide:
    """Compare a variant's run with the published values over the same corruptions."""
    measured = [name for name in run.measured.corruptions if name in _in_paper(artefact)]
    (numbers,) = lines_of(run_frame([run], beside_published=True)).values()
    here = _values_over(numbers, measured)
    levels = run.manifest.severities
    differs = run.setting not in (runnable.variant.setting, "untrained")
    notes = (
        runnable.weights,
        f"{run.setting}, not the setting of this row" if differs else "",
        comparison_note(run, beside_published=True),
        "" if len(measured) == len(_in_paper(artefact)) else "the published average is over the same corruptions",
        "" if set(levels) == set(SEVERITIES) else "the published values are over all five severities",
    )
    published = _published(artefact, runnable.variant, measured)
    return SideBySide(runnable.variant, published, here, "; ".join(filter(None, notes)), runnable.random)


def paper_alone(artefact: Artefact, variant: Variant) -> SideBySide:
    """Return a comparison that contains only the paper's values."""
    return SideBySide(variant, _published(artefact, variant, _in_paper(artefact)), {})


def _in_paper(artefact: Artefact) -> tuple[str, ...]:
    return benchmark_facts(artefact.benchmark).paper_corruptions


def _published(artefact: Artefact, variant: Variant, measured: Sequence[str]) -> MetricValues:
    of_variant = (artefact.benchmark, variant.setting, variant.method)
    lines = published_lines().items()
    numbers = next(numbers for key, numbers in lines if (key.benchmark, key.setting, key.model) == of_variant)
    averages = {key: row for key, row in numbers.items() if key[1] == AVERAGE and row["origin"] != DERIVED}
    printed = {(measure, of): row["value"] for (measure, of, _), row in averages.items()}
    if artefact.columns == "crer" and ("crer", AVERAGE) not in printed:
        return {}  # Tab. 3 does not contain the method
    values = _values_over(numbers, measured)
    return values if len(measured) < len(_in_paper(artefact)) else {**values, **printed}


def _values_over(numbers: Numbers, corruptions: Sequence[str]) -> MetricValues:
    """Return the values on the clean frames and under some corruptions, with the averages over these corruptions, and
    the CREr of each family as ("crer", FAMILY)."""
    known = {key: row["value"] for key, row in numbers.items() if key[0] in RESULT_METRICS}
    values = {(m, of): value for (m, of, at), value in known.items() if at is None and of in (CLEAN, *corruptions)}
    for metric in RESULT_METRICS:
        if of_these := [values[metric, name] for name in corruptions if (metric, name) in values]:
            values[metric, AVERAGE] = exact_mean(of_these)
    changes, clean = numbers.changes(), values.get(("epe", CLEAN))
    cre = {name: changes[name] for name in corruptions if name in changes}
    if (ratio := crer(exact_mean([*cre.values()]) if cre else None, clean)) is not None:
        values["crer", AVERAGE] = ratio
    return values | {("crer", family): value for family, value in family_crer(cre, clean).items()}


def columns_of(artefact: Artefact, variants: Sequence[SideBySide]) -> list[tuple[Column, tuple[str, str]]]:
    """Return the columns of a table or figure for which at least one variant has a value, with their keys; if there is
    none, all columns."""
    if artefact.columns == "means":
        every = [(Column(mean_label(*key)), key) for key in OVERALL]
    elif artefact.columns == "families":
        every = [(Column(FAMILY_LABELS[family], group="CREr"), ("crer", family)) for family in FAMILIES]
    elif artefact.columns == "crer":
        every = [(Column("CREr"), ("crer", AVERAGE))]
    else:
        metric = artefact.columns
        every = [(Column("Clean"), (metric, CLEAN))] if metric == "epe" else []
        every += [
            (Column(short_label(name), group=family_label(name) or ""), (metric, name)) for name in _in_paper(artefact)
        ]
        every.append((Column(f"AVG {LABELS[metric]}"), (metric, AVERAGE)))
    shown = [entry.here or entry.published for entry in variants]
    return [(column, key) for column, key in every if any(key in values for values in shown)] or every


def comparison_table(artefact: Artefact, variants: Sequence[SideBySide]) -> Table:
    """Return three rows for each variant with a run (published, here, difference), and one row for each variant
    without a run."""
    columns = columns_of(artefact, variants)
    keys = [key for _, key in columns]
    rows: dict[str, list[Row]] = {}
    for setting in dict.fromkeys(entry.variant.setting for entry in variants):
        here = (entry for entry in variants if entry.variant.setting == setting)
        rows[SETTING_LABELS.get(setting, setting)] = [row for entry in here for row in _rows(entry, keys)]
    title = f"{artefact.name}: {artefact.title}"
    return Table.of(artefact.name, title, [column for column, _ in columns], rows, keep_empty=True)


def _rows(variant: SideBySide, keys: Sequence[tuple[str, str]]) -> list[Row]:
    published, here, method = variant.published, variant.here, variant.variant.method
    # Corruptions that were not run are not compared.
    rows = [Row(f"{method}, paper", [published.get(key) if not here or key in here else None for key in keys])]
    if here:
        rows.append(
            Row(f"{method}, {'RANDOM WEIGHTS' if variant.random else 'here'}", map(here.get, keys), variant.note)
        )
        both = published.keys() & here.keys()
        rows.append(
            Row("  difference", [f"{here[key] - published[key]:+.2f}" if key in both else None for key in keys])
        )
    return rows


def comparison_csv(artefact: Artefact, variants: Sequence[SideBySide]) -> str:
    """Return one row per value: setting, model, metric, corruption (or family), published, here, difference, note."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["setting", "model", "metric", "corruption", "published", "here", "difference", "random", "note"])
    for entry in variants:
        published, here = entry.published, entry.here
        for _, key in columns_of(artefact, variants):
            both = (published.get(key), here.get(key))
            difference = None if None in both else here[key] - published[key]
            cells = ["" if value is None else f"{value:.6g}" for value in (*both, difference)]
            note, random = (text_cell(entry.note), "yes" if entry.random else "no") if entry.here else ("", "")
            writer.writerow([entry.variant.setting, entry.variant.method, *key, *cells, random, note])
    return out.getvalue()
