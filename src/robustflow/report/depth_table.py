"""The table of flat corruptions and their twins in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence

from ..analysis.attack_ranks import LEAST_MODELS
from ..analysis.flat_and_depth import TwinComparison, TwinErrors, twin_comparisons
from ..analysis.labels import METRIC_LABELS
from ..errors import RunError, UsageError
from ..runs.run import Run
from ..text import counted, plain
from .table import DASH, Column, Line, Section, Table, number_text

FLAT_AND_DEPTH = "flat-and-depth"


def depth_table(runs: Sequence[Run], seed: int = 0) -> Table:
    """Rank correlations over models and differences of each model between flat corruptions and their twins.

    Raises:
        UsageError: no run has both of a kind, or the runs have no frames in common.
    """
    try:
        found = twin_comparisons(runs, seed)
    except RunError as error:
        raise UsageError(str(error)) from error
    if not found:
        raise UsageError(
            f"the table '{FLAT_AND_DEPTH}' needs runs with a corruption and its twin in three dimensions: "
            "--corruptions fog,fog_3d"
        )
    label = METRIC_LABELS[found[0].metric]
    columns = tuple(map(Column, ("flat (px)", "in depth (px)", "value", "95 % low", "95 % high")))
    remarks = [
        f"{label} of a flat corruption and of its twin in three dimensions, on the same pairs and severities. Value: "
        "Spearman's rank correlation over models with its interval by Fisher's z; of a model the difference, depth "
        "minus flat, px, with its interval over pairs, or groups of pairs. Models that are not ranked are in no "
        "correlation."
    ]
    if any(one.count < LEAST_MODELS for one in found):
        remarks.append(f"No correlation is given for fewer than {LEAST_MODELS} models.")
    sections = [Section("Rank correlation over models", tuple(map(_correlation_line, found)))]
    sections += [Section(_title(one), tuple(_model_line(model) for model in one.models)) for one in found]
    title = "Do flat corruptions predict those in three dimensions?"
    return Table(FLAT_AND_DEPTH, title, columns, tuple(sections), tuple(remarks), "Corruptions, model")


def _title(one: TwinComparison) -> str:
    return f"{one.flat} and {one.deep}, severities {', '.join(map(str, one.severities))}"


def _correlation_line(one: TwinComparison) -> Line:
    low, high = one.interval or (None, None)
    texts = [DASH if value is None else f"{value:+.2f}" for value in (one.rho, low, high)]
    few = f"{counted(one.count, 'ranked model')}: too few for a correlation" if one.count < LEAST_MODELS else ""
    return Line.of(f"{one.flat}, {one.deep} ({counted(one.count, 'model')})", (DASH, DASH, *texts), few)


def _model_line(model: TwinErrors) -> Line:
    values = (model.flat, model.deep, model.difference, model.low, model.high)
    return Line.of(plain(model.model), tuple(number_text(value, 2) for value in values), model.excluded)
