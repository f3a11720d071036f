"""Table that compares 2D corruptions with their 3D counterparts."""

from __future__ import annotations

from collections.abc import Sequence

from ..analysis.flat_and_depth import TwinComparison, TwinErrors, twin_comparisons
from ..analysis.labels import METRIC_LABELS
from ..analysis.ranking import LEAST_MODELS
from ..errors import RunError, UsageError
from ..runs.run import Run
from ..text import counted, plain
from .table import DASH, Column, Line, Section, Table, number_text

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
