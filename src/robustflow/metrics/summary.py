"""Define `Summary`, the means of a run as typed fields, as stored in `summary.json`."""

from __future__ import annotations

from typing import Literal

import polars as pl

from ..core.errors import unknown_name
from ..core.types import FrozenFinite
from .rows import ROW_SCHEMA_VERSION

Averaging = Literal["image", "pixel"]
"""`image` (as in the paper): average over the pixels of each image, then over the images. `pixel`: average over the
pixels of all images together. In both cases, the results are then averaged over severities and finally over
corruptions.
"""

METRICS = (
    "epe",
    "cre",
    "crer",
    "rcre",
    "rcre_all",
    "fl",
    "px1",
    "px3",
    "px5",
    "wauc",
    "photometric",
    "coverage",
    "spread",
)

SUMMARY_VERSION = 5
"""Version of the summary, incremented when a field is added or changes its meaning. A summary with a different version
is rewritten or rejected.
"""


class Scores(FrozenFinite):
    """Means of the metrics; None if there are no pixels to average over (e.g. no ground truth)."""

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
    photometric: float | None = None
    coverage: float | None = None
    spread: float | None = None


class CorruptionScores(Scores):
    """Means over the severities of one corruption, and the values at each severity."""

    family: str | None
    severities: list[int]
    by_severity: dict[str, list[float | None]]


class RegionScores(Scores):
    """Overall means over the pixels of one region; images without pixels in the region are excluded."""

    share: float | None = None
    epe_clean: float | None = None
    fl_clean: float | None = None


class MissingCells(FrozenFinite):
    """A list of samples for one corruption at one severity."""

    corruption: str
    severity: int
    samples: list[str]


class Summary(Scores):
    """The means of a run; the overall scores are averages over `averaged_over`.

    Attributes:
        version: version of the summary.
        row_schema: schema version of the rows from which the summary was computed.
        averaging: averaging order, see `Averaging`.
        complete: False if anything is listed in `missing` or `unmeasured`; the means cover only what was measured.
        missing: samples that are part of the plan but have no row.
        unmeasured: rows without any pixel to measure (no finite prediction or no valid ground truth).
        samples: number of samples.
        n_invalid: number of pixels without a finite prediction, over all rows; excluded from all means.
        epe_clean: end-point error on the clean frames, pixels.
        clean_flow_length: mean magnitude of the predicted flow on the clean frames over all pixels, in pixels; the
            reference for an RCRE without ground truth.
        photometric_still: photometric error of zero flow on the clean frames, in grey levels; a flow with a similar
            error does not follow the motion.
        clean: metrics on the clean frames, where CRE and CREr are undefined.
        averaged_over: corruptions included in the overall means: all that were run, except those that leave no ground
            truth (`Corruption.truth`) if there are others.
        corruptions: means for each corruption: the paper's corruptions in the paper's order, then the others by name.
        families: means over the corruptions of each family.
        regions: overall means over each region that occurs.
        paper: means over exactly the paper's corruptions on this benchmark; None unless all of them were run. Only
            these means are comparable with published averages.
        paper_over: corruptions over which `paper` averages; empty if `paper` is None.
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
    photometric_still: float | None
    clean: Scores
    averaged_over: list[str]
    corruptions: dict[str, CorruptionScores]
    families: dict[str, Scores]
    regions: dict[str, RegionScores]
    paper: Scores | None = None
    paper_over: list[str] = []

    def severities(self) -> list[int]:
        """Return all severities in the summary, in ascending order."""
        return sorted({level for scores in self.corruptions.values() for level in scores.severities})

    def without_truth(self) -> list[str]:
        """Return the corruptions that leave no ground truth (`Corruption.truth`), as far as the means show it."""
        known = self.epe_clean is not None
        return [
            name
            for name, scores in self.corruptions.items()
            if name not in self.averaged_over or (known and scores.epe is None and scores.rcre is not None)
        ]

    def table(self, metric: str = "epe") -> pl.DataFrame:
        """Return one metric as a table with one row per corruption, in the paper's order.

        Returns:
            A table with the columns `corruption`, `family`, one for each severity ("1" ... "5"), and `mean`; null where
            nothing was measured.

        Raises:
            UsageError: the metric is unknown.
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
    """Whether some pixels have no prediction, so that tables need a column `coverage`."""
    each = (summary.clean, *summary.corruptions.values())
    return any(scores.coverage is not None and scores.coverage < 1 for scores in each)
