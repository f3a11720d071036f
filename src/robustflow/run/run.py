"""The class `Run`, the contents of a run folder, and its rows as one file for other programs."""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import RobustFlowError, RunError, unknown_name
from ..core.files import json_bytes
from ..core.text import counted, plain, text_cell
from ..corruptions.registry import family_of, ordered
from ..data.benchmarks import benchmark_facts, outside_remark
from ..data.benchmarks.facts import sample_noun, truth_remark
from ..data.benchmarks.setting import Provenance
from ..metrics.cube import AVERAGE, Averaging, Means
from ..metrics.measures import METRICS
from ..metrics.rows import CLEAN, ROW_SCHEMA_VERSION
from ..models.catalog import methods
from .manifest import UNEVEN, Cell, Manifest
from .store import RunFolder
from .summary import Averages, Measured, summarize
from .trust import Derived

SUMMARY = "summary.json"


class Run:
    """The results of a run, finished or not."""

    record = ""

    def __init__(self, folder: str | Path, asked: Manifest | None = None) -> None:
        self._folder = RunFolder(folder)
        self.path = self._folder.path
        self._asked = asked
        manifest = asked or self._folder.manifest()
        if manifest is None:
            advice = "give a folder written by 'run', or several of them as FOLDER/*"
            raise RunError(self.path, f"not a run folder (it has no manifest.json); {advice}")
        self.manifest: Manifest = manifest

    @cached_property
    def rows(self) -> pl.DataFrame:
        """Return one row per (sample, corruption, severity), with the columns of `robustflow.metrics.rows.ROW_SCHEMA`.
        Rows of attacks are in `attack_rows`, so that no mean over corruptions includes them."""
        return self._every_row().filter(self._is_corruption())

    @property
    def attack_rows(self) -> pl.DataFrame:
        """Return one row per (sample, attack, severity), with the attack in the column `corruption`, and the clean
        rows."""
        return self._every_row().filter(pl.col("corruption").is_in([CLEAN, *self.attacks]))

    def _is_corruption(self) -> pl.Expr:
        return ~pl.col("corruption").is_in(self.attacks)

    @property
    def attacks(self) -> list[str]:
        """Return the attacks of this run, controls first."""
        return list(self.manifest.attacks)

    def _every_row(self) -> pl.DataFrame:
        _ = self.rows_digest  # computed first, so that rows written in between do not match the digest
        return self._folder.rows().filter(self._is_asked())

    def _is_asked(self) -> pl.Expr:
        return pl.any_horizontal(part.contain() for part in self._asked.planned) if self._asked else pl.lit(True)

    @cached_property
    def rows_digest(self) -> str:
        """Return a hash of the rows on disk at the time of the first read."""
        return self._folder.digest()

    def release_rows(self) -> None:
        """Free the memory of the rows; the rows are read again when needed."""
        self.__dict__.pop("rows", None)

    @cached_property
    def averages(self) -> Averages:
        """Return the means over the corruptions of this run, and what they cover."""
        kind = list[tuple[str, str, int | None, float]]
        stored = self.derived.value("means", kind, lambda: [(*key, one) for key, one in self._computed.means.items()])
        covered = self.derived.value("measured", dict[str, Any], lambda: self._computed.measured.model_dump())
        measured = Measured.model_validate(covered)
        in_order = {name: measured.corruptions[name] for name in ordered(measured.corruptions)}  # JSON sorts keys
        means = {(measure, condition, severity): value for measure, condition, severity, value in stored}
        return Averages(means, measured.model_copy(update={"corruptions": in_order}))

    @property
    def means(self) -> Means:
        """Return the means over the corruptions of this run: (measure, condition, severity) -> value."""
        return self.averages.means

    @property
    def measured(self) -> Measured:
        """Return what the rows of this run contain: missing cells, and the corruptions that the means cover."""
        return self.averages.measured

    def mean(self, measure: str, condition: str = AVERAGE, severity: int | None = None) -> float | None:
        """Return a mean of this run; None if nothing was measured.

        Args:
            measure: name of a measure, such as "cre" (`robustflow.metrics.MEASURES`, and "crer").
            condition: "average", "clean", a corruption, a family, a region of the image, or "paper": the mean over
                exactly the paper's corruptions, if all of them were run.
            severity: a severity, or None for the mean over severities.
        """
        return self.averages.mean(measure, condition, severity)

    def average(self, averaging: Averaging = "image") -> Averages:
        """Compute the means from the rows, averaged as in the paper ("image"), or over the pixels of all images
        together ("pixel")."""
        paper = benchmark_facts(self.benchmark).paper_corruptions
        if "rows" not in self.__dict__:
            _ = self.rows_digest  # computed before the rows are read, as in `_every_row`
            try:
                rows = self._folder.scan().filter(self._is_asked() & self._is_corruption())
                return summarize(rows, averaging, self._planned(), paper=paper)
            except (RobustFlowError, FileNotFoundError, pl.exceptions.PolarsError, pl.exceptions.PanicException):
                pass  # merged in the meantime, duplicated by a crash, or damaged: reading `rows` reports the cause
        return summarize(self.rows, averaging, self._planned(), paper=paper)

    @property
    def epe_clean(self) -> float | None:
        """Return the mean end-point error on the clean frames, in pixels; None without ground truth."""
        return self.mean("epe", CLEAN)

    @property
    def epe(self) -> float | None:
        """Return the mean end-point error over severities and corruptions, in pixels; None without ground truth."""
        return self.mean("epe")

    @property
    def cre(self) -> float | None:
        """Return the Corruption Robustness Error in pixels (paper Eq. 1); None without ground truth."""
        return self.mean("cre")

    @property
    def crer(self) -> float | None:
        """Return the Corruption Robustness Error ratio, CRE / clean EPE (paper Eq. 2); None without ground truth."""
        return self.mean("crer")

    @property
    def rcre(self) -> float | None:
        """Return the Relative Corruption Robustness Error in pixels (paper Eq. 3)."""
        return self.mean("rcre")

    @property
    def name(self) -> str:
        """Return the model's name for headings, tables and figures: `--name` if given, else the name of a registered
        method as in `list models` ("DIS" for `dis`), else the model's own name. Never blank."""
        model = self.manifest.identity.model.settings
        name = self.manifest.name.strip()
        method = None if {"spec", "object"} & model.keys() else methods().get(str(model.get("name")))
        names = (str(model[key]).strip() for key in ("spec", "name", "object") if model.get(key))
        return name or (method.method if method is not None else next(filter(None, names), "(no name)"))

    @property
    def benchmark(self) -> str:
        """Return the benchmark's name."""
        return self.manifest.identity.frames.benchmark

    @property
    def setting(self) -> str:
        """Return the relation of the model's training data to the benchmark: "OOD", "ID", "LEAKED", ...
        (`robustflow.data.benchmarks.setting`)."""
        return self.provenance.setting

    @cached_property
    def provenance(self) -> Provenance:
        """Return the model's training data, and what they mean for the run."""
        return self.manifest.provenance

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
        levels: list[int | None] = [*self.measured.severities, None]
        schema: dict[str, type[pl.DataType]] = {"corruption": pl.String, "family": pl.String}
        schema |= {"mean" if level is None else str(level): pl.Float64 for level in levels}
        lines = [
            (name, family_of(name), *(self.mean(metric, name, level) for level in levels))
            for name in self.measured.corruptions
        ]
        return pl.DataFrame(lines, schema=schema, orient="row")

    @property
    def left_out(self) -> dict[str, tuple[int, ...]]:
        """Return the requested severities that do not exist on the run's severity scale, by corruption; no mean
        includes them."""
        return self.manifest.left_out

    def document(self) -> dict[str, Any]:
        """Return the content of `summary.json`: means by the paper's averaging, pooled means, the run, and its setting.
        Always computed from the rows."""
        return {
            **self._computed.document("image"),
            "pooled": self.average("pixel").document("pixel"),
            "run": self.manifest.identity_digest,
            "setting": self.setting,
        }

    def __str__(self) -> str:
        """Return the results in a few lines, for `print(result)`."""
        return "\n".join(_lines(self))

    def write_means(self) -> None:
        """Write `summary.json`, the means over everything in the folder, unless the existing one was made from these
        rows."""
        if self._asked is not None:
            Run(self.path).write_means()
        elif self.derived.write_file(SUMMARY, lambda: json_bytes(self.document())):
            _ = self.averages
            self.derived.write_values()

    def keep(self) -> None:
        """Store the means and the values computed so far with the run, if its folder is writable; a page about
        many runs then does not need to read their rows."""
        if self._asked is not None:
            return  # the folder's files describe all its rows
        try:
            self.write_means()
            self.derived.write_values()
        except RobustFlowError:
            pass  # The folder is read-only, so the next page computes the values again.

    @cached_property
    def derived(self) -> Derived:
        """Return the files and values computed from these rows."""
        return Derived(self.path, self.rows_digest, self.manifest.document())

    @cached_property
    def _computed(self) -> Averages:
        return self.average()

    def planned(self) -> list[Cell]:
        """Return every (sample, corruption, severity) of a complete run; clean rows as (sample, "clean", 0)."""
        return list(self._planned())

    def _planned(self) -> Iterator[Cell]:
        return chain.from_iterable(part.corrupted() for part in self.manifest.planned)


def _lines(run: Run) -> list[str]:
    """Describe the run, its means, and the missing cells."""
    title = benchmark_facts(run.benchmark).title
    samples = len(run.manifest.samples)
    truth = truth_remark(run.manifest.identity.frames.protocol)
    outside = outside_remark(run.benchmark, run.manifest.identity.frames.protocol, run.manifest.samples)
    on = ", ".join(filter(None, (plain(title), counted(samples, sample_noun(run.benchmark)), outside, truth)))
    head = f"{plain(run.name)} ({plain(run.setting)}) on {on}"
    means = [
        f"{name} {value:.4g}{unit}"
        for name, value, unit in (
            ("clean EPE", run.epe_clean, " px"),
            ("EPE", run.epe, " px"),
            ("CRE", run.cre, " px"),
            ("CREr", run.crer, ""),
            ("RCRE", run.rcre, " px"),
            ("clean flow", None if run.epe_clean is not None else run.mean("flow_length", CLEAN), " px long"),
            ("photometric error", None if run.epe_clean is not None else run.mean("photometric"), " grey levels"),
        )
        if value is not None
    ]
    complete = "" if run.measured.complete else "not complete: "
    over = ", ".join(map(plain, run.measured.averaged_over)) or "nothing yet"
    over += f" ({UNEVEN})" if run.manifest.uneven else ""
    return [head, ", ".join(means) or "nothing measured", f"{complete}mean over {over}", plain(str(run.path), None)]


ROWS_FORMATS = ("csv", "parquet")


def rows_bytes(run: Run, format: str) -> bytes:
    """Return the rows of a run, sorted by sample, corruption and severity, as a file."""
    rows = run.rows.sort("sample", "corruption", "severity")
    out = io.BytesIO()
    if format == "csv":
        texts = [name for name, kind in rows.schema.items() if kind == pl.String]
        safe = pl.col(texts).map_elements(text_cell, return_dtype=pl.String)
        rows.with_columns(safe).write_csv(out)
    elif format == "parquet":
        about = {
            "robustflow_run": run.manifest.identity_digest,
            "robustflow_row_schema": str(ROW_SCHEMA_VERSION),
        }
        rows.write_parquet(out, metadata=about)
    else:
        raise unknown_name("format of rows", format, ROWS_FORMATS)
    return out.getvalue()
