"""Store the histogram of flow magnitudes with a run's rows, for its pages."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import polars as pl
from pydantic import Field, model_validator

from ..metrics.rows import CLEAN
from .attachment import RunAttachment, read_attachment, write_attachment

if TYPE_CHECKING:
    from .run import Run

DISPLACEMENT = "displacement.json"
GROUND_TRUTH = "ground truth"
"""Value of `source` for a histogram of the ground truth."""
_LARGEST = 1 << 20
_MOST_BINS = 10_000


class DisplacementFile(RunAttachment):
    """The contents of `RUN/displacement.json`."""

    samples: Annotated[int, Field(ge=1)]
    source: Annotated[str, Field(min_length=1, max_length=500)]
    low: Annotated[list[Annotated[float, Field(ge=0, le=1e9)]], Field(min_length=1, max_length=_MOST_BINS)]
    pixels: Annotated[list[Annotated[int, Field(ge=0, le=10**18)]], Field(min_length=1, max_length=_MOST_BINS)]

    @model_validator(mode="after")
    def _bins_fit(self) -> DisplacementFile:
        if len(self.low) != len(self.pixels) or self.low[0] != 0 or sorted(set(self.low)) != self.low:
            raise ValueError("edges must ascend from 0, with one edge per count")
        return self

    @property
    def table(self) -> pl.DataFrame:
        """Return a table with the columns `low`, `high` (pixels, the last infinite) and `share` (of all counted
        pixels)."""
        total = max(1, sum(self.pixels))
        share = [count / total for count in self.pixels]
        return pl.DataFrame({"low": self.low, "high": [*self.low[1:], math.inf], "share": share})


def read_displacement(run: Run) -> DisplacementFile | None:
    """Return the histogram stored in a run's folder; None if it does not exist, or if the run now has different
    samples.
    """
    displacement = read_attachment(DisplacementFile, run, DISPLACEMENT, _LARGEST, "reproduce displacement --into RUN")
    return displacement if displacement and displacement.samples == len(run.manifest.samples) else None


def write_displacement(run: Run, table: pl.DataFrame) -> Path:
    """Store the table of `displacement_histogram` for a run's samples in the run's folder."""
    content = DisplacementFile(
        run=run.manifest.identity_digest,
        samples=len(run.manifest.samples),
        source=table["source"][0],
        low=table["low"].to_list(),
        pixels=table["pixels"].to_list(),
    )
    return write_attachment(run, DISPLACEMENT, content)


def clean_digests(run: Run) -> dict[str, str]:
    """Map every sample that a run has measured to the digest of its clean frames."""
    return dict(run.rows.filter(corruption=CLEAN).select("sample", "frames_digest").iter_rows())
