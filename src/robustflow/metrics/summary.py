"""`Summary`: the means of a run, typed, as written to `summary.json`."""

from __future__ import annotations

from typing import Literal

import polars as pl

from ..errors import unknown_name
from ..validated import FrozenFinite
from .rows import ROW_SCHEMA_VERSION

Averaging = Literal["image", "pixel"]
"""`image`: the paper's, mean over the pixels of an image, then over images. `pixel`: over the pixels of all
images at once. Means over severities, then over corruptions, follow in both."""

METRICS = ("epe", "cre", "crer", "rcre", "rcre_all", "fl", "px1", "px3", "px5", "wauc", "coverage", "spread")

SUMMARY_VERSION = 4
"""Incremented when a field is added or changes its meaning; one of another version is written again, or refused."""


class Scores(FrozenFinite):
    """Means of the metrics; None if there is nothing to average (no ground truth, no such pixels).

    Attributes:
        epe: end-point error, pixels.
        cre: Corruption Robustness Error, pixels.
        crer: CRE / clean EPE.
        rcre: Relative Corruption Robustness Error, pixels, over the pixels with valid ground truth (over all
            pixels for samples without ground truth).
        rcre_all: the same over all pixels.
        fl: Fl-all, percent.
        px1, px3, px5: pixels with an error above 1, 3, 5 px, percent.
        wauc: weighted area under the inlier curve, percent (100 is best).
        coverage: share of the pixels with ground truth (of all pixels, without ground truth) included in the means, 0
            to 1: the others were not predicted, here or on the clean frames.
        spread: standard deviation of the flow over the draws of the corruption, pixels, over all pixels; None in a run
            of one draw.
    """

    epe: float | None = None
    cre: float | None = None
    crer: float | None = None
    rcre: float | None = None
    rcre_all: float | None = None
    fl: float | None = None
    px1: float | None = None
    px3: float | None = None
    px5: float | None = None
    wauc: float | None = None
    coverage: float | None = None
    spread: float | None = None


class CorruptionScores(Scores):
    """Means over the severities of one corruption, and the values at each.

    Attributes:
        family: one of the paper's families, which also hold corruptions that exist only as files; None for one without.
        severities: the measured severities, ascending.
        by_severity: for each metric a list in the order of `severities`.
    """

    family: str | None
    severities: list[int]
    by_severity: dict[str, list[float | None]]


class RegionScores(Scores):
    """Overall means inside one region; images without a pixel of it are not averaged.

    Attributes:
        share: the region's part of the valid pixels of the clean rows of samples that have it, percent.
        epe_clean, fl_clean: on the clean frames.
    """

    share: float | None = None
    epe_clean: float | None = None
    fl_clean: float | None = None


class MissingCells(FrozenFinite):
    """Samples under one corruption at one severity."""

    corruption: str
    severity: int
    samples: list[str]


class Summary(Scores):
    """The means of a run; the scores at the top are over the corruptions in `averaged_over`: all that were run.

    Attributes:
        version: of the summary.
        row_schema: version of the rows it was made from.
        averaging: see `Averaging`.
        complete: False if anything is listed in `missing` or `unmeasured`; the means are over what exists.
        missing: planned, but not among the rows.
        unmeasured: rows without a single pixel to measure (no predicted flow is finite, or no ground truth
            is valid).
        samples: number of samples.
        n_invalid: predicted pixels that are not finite, in all rows; they are excluded from all means.
        epe_clean: end-point error on the clean frames.
        clean_flow_length: mean length of the predicted flow on the clean frames, pixels, over all pixels: what an RCRE
            without ground truth is read against.
        clean: the metrics on the clean frames, where CRE and CREr are not defined.
        averaged_over: corruptions in the overall means.
        corruptions: in the paper's order, then the others by name.
        families: means over the corruptions of each family.
        regions: overall means inside each region that occurs.
        paper: the paper's mean, over only its corruptions on this benchmark; None unless all of them were run. Only
            this mean can be compared with published averages.
        paper_over: the corruptions of `paper`, empty if it is None.
    """

    version: int = SUMMARY_VERSION
    row_schema: int = ROW_SCHEMA_VERSION
    averaging: Averaging
    complete: bool
    missing: list[MissingCells]
    unmeasured: list[MissingCells]
    samples: int
    n_invalid: int
    epe_clean: float | None
    clean_flow_length: float | None
    clean: Scores
    averaged_over: list[str]
    corruptions: dict[str, CorruptionScores]
    families: dict[str, Scores]
    regions: dict[str, RegionScores]
    paper: Scores | None = None
    paper_over: list[str] = []

    def severities(self) -> list[int]:
        """The severities that occur, ascending."""
        return sorted({level for scores in self.corruptions.values() for level in scores.severities})

    def table(self, metric: str = "epe") -> pl.DataFrame:
        """One metric, corruption x severity, in the paper's order.

        Returns:
            Columns `corruption`, `family`, one per severity ("1" ... "5"), `mean`; null where nothing was
            measured.

        Raises:
            UsageError: unknown metric.
        """
        if metric not in METRICS:
            raise unknown_name("metric", metric, METRICS)
        severities = self.severities()
        records = []
        for name, scores in self.corruptions.items():
            cells = dict(zip(scores.severities, scores.by_severity[metric], strict=True))
            records.append((name, scores.family, *map(cells.get, severities), getattr(scores, metric)))
        schema: dict[str, type[pl.DataType]] = {"corruption": pl.String, "family": pl.String}
        schema |= {str(severity): pl.Float64 for severity in severities} | {"mean": pl.Float64}
        return pl.DataFrame(records, schema=schema, orient="row")


def has_gaps(summary: Summary) -> bool:
    """Whether the model left out pixels, so that tables need the column `coverage`."""
    each = (summary.clean, *summary.corruptions.values())
    return any(scores.coverage is not None and scores.coverage < 1 for scores in each)
