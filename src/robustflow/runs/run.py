"""`Run`: the contents of a run folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import polars as pl

from ..atomic import write_json
from ..benchmarks import benchmark_facts
from ..benchmarks.facts import sample_noun, truth_remark
from ..errors import RobustFlowError, RunError
from ..metrics.rows import CLEAN
from ..metrics.summary import Averaging, Summary
from ..models.catalog import methods
from ..text import counted, plain
from .aggregate import summarize, summary_in_order
from .cached_values import CachedValues
from .manifest import Manifest
from .plan import Cell, planned_cells
from .provenance import Provenance
from .staleness import is_current, note_made, source_digest
from .store import RunFolder

SUMMARY = "summary.json"

Cached = TypeVar("Cached")


class Run:
    """The results of a run, finished or not.

    Args:
        folder: the run's folder.

    Raises:
        RunError: no run in it, or one that this version cannot read.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = RunFolder(folder)
        self.path = self._folder.path
        manifest = self._folder.manifest()
        if manifest is None:
            raise RunError(
                f"{self.path} is not a run's folder (it has no manifest.json); give the folder that 'run' wrote"
            )
        self.manifest: Manifest = manifest

    @cached_property
    def rows(self) -> pl.DataFrame:
        """One row per (sample, corruption, severity); the columns are `robustflow.metrics.rows.ROW_SCHEMA`. Rows of
        attacks are in `attack_rows`, so that no mean over corruptions includes them."""
        rows = self._every_row()
        return rows.filter(~pl.col("corruption").is_in(self.attacks)) if self.attacks else rows

    @property
    def attack_rows(self) -> pl.DataFrame:
        """One row per (sample, attack, severity), with the attack in the column `corruption`, and the clean rows."""
        return self._every_row().filter(pl.col("corruption").is_in([CLEAN, *self.attacks]))

    @property
    def attacks(self) -> list[str]:
        """The attacks of this run, controls first."""
        return list(self.manifest.selection.attacks)

    def _every_row(self) -> pl.DataFrame:
        _ = (
            self.rows_digest
        )  # before the rows are read: rows that arrive in between must not count as those of the digest
        return self._folder.rows()

    @cached_property
    def rows_digest(self) -> str:
        """A hash of the rows as they were on disk when they were first read."""
        return self._folder.digest()

    def release_rows(self) -> None:
        """Free the memory of the rows; they are read again when needed."""
        self.__dict__.pop("rows", None)

    @cached_property
    def summary(self) -> Summary:
        """Means over the corruptions of this run, the paper's means, and where they are incomplete.

        Read from `summary.json` if that was made from these rows, otherwise computed.
        """
        return self._stored_means() or self._means

    def summarize(self, averaging: Averaging = "image") -> Summary:
        """Means by the paper's averaging ("image"), or over the pixels of all images at once ("pixel")."""
        paper = benchmark_facts(self.benchmark).paper_corruptions
        if "rows" not in self.__dict__:
            _ = self.rows_digest  # before the rows are read, as in `_every_row`
            try:
                rows = self._folder.scan().filter(~pl.col("corruption").is_in(self.attacks))
                return summarize(rows, averaging, planned_cells(self.manifest), paper=paper)
            except (RobustFlowError, FileNotFoundError, pl.exceptions.PolarsError, pl.exceptions.PanicException):
                pass  # merged meanwhile, left twice by a crash, or damaged: `rows` says which
        return summarize(self.rows, averaging, planned_cells(self.manifest), paper=paper)

    @property
    def epe_clean(self) -> float | None:
        """Mean end-point error on the clean frames, pixels; None without ground truth."""
        return self.summary.epe_clean

    @property
    def epe(self) -> float | None:
        """Mean end-point error over severities and corruptions, pixels; None without ground truth."""
        return self.summary.epe

    @property
    def cre(self) -> float | None:
        """Corruption Robustness Error, pixels (paper Eq. 1); None without ground truth."""
        return self.summary.cre

    @property
    def crer(self) -> float | None:
        """Corruption Robustness Error ratio, CRE / clean EPE (paper Eq. 2); None without ground truth."""
        return self.summary.crer

    @property
    def rcre(self) -> float | None:
        """Relative Corruption Robustness Error, pixels (paper Eq. 3)."""
        return self.summary.rcre

    @property
    def name(self) -> str:
        """The model's name, for headings, tables and figures; never blank: `--name`, else a registered method's as
        `list models` has it ("DIS" for `dis`), else what the model calls itself."""
        model = self.manifest.identity.model.settings
        given = self.manifest.name.strip()
        method = None if {"spec", "object"} & model.keys() else methods().get(str(model.get("name")))
        names = (str(model[key]).strip() for key in ("spec", "name", "object") if model.get(key))
        return given or (method.method if method is not None else next(filter(None, names), "(no name)"))

    @property
    def benchmark(self) -> str:
        """The benchmark's name."""
        return self.manifest.identity.frames.benchmark

    @property
    def setting(self) -> str:
        """What the model's training means for the benchmark: "OOD", "ID", "LEAKED", ...
        (`robustflow.benchmarks.setting`)."""
        return self.provenance.setting

    @cached_property
    def provenance(self) -> Provenance:
        """The facts about the model's training, and what they mean for the run."""
        return self.manifest.judged().provenance

    def table(self, metric: str = "epe") -> pl.DataFrame:
        """One metric, corruption x severity, in the paper's order."""
        return self.summary.table(metric)

    @property
    def left_out(self) -> dict[str, tuple[int, ...]]:
        """Requested severities that do not exist on the run's severity scale, by corruption; no mean includes them."""
        return self.manifest.left_out

    def document(self) -> dict[str, Any]:
        """What `summary.json` holds: means by the paper's averaging, the pooled ones, which run, and its setting.
        Always computed from the rows."""
        return {
            **self._means.model_dump(),
            "pooled": self.summarize("pixel").model_dump(),
            "run": self.manifest.identity_digest,
            "setting": self.setting,
        }

    def __str__(self) -> str:
        """The results in a few lines, for `print(result)`."""
        return "\n".join(_lines(self))

    def write_means(self) -> None:
        """Write `summary.json`, unless the existing one was made from these rows."""
        if not is_current(self.path, SUMMARY, self._source):
            write_json(self.path / SUMMARY, self.document())
            note_made(self.path, SUMMARY, self._source)

    def cached_value(self, name: str, kind: type[Cached], make: Callable[[], Cached]) -> Cached:
        """A value that follows from the rows and is costly to compute: stored for exactly these rows, or computed now.

        Args:
            name: of the value.
            kind: its type, one that JSON holds.
            make: computes it.
        """
        return self._cached.get(name, kind, make)

    def has_cached_value(self, name: str) -> bool:
        """Whether such a value is known already."""
        return name in self._cached

    def keep(self) -> None:
        """Store the means and the values computed so far with the run, if its folder can be written; a page of many
        runs then reads no rows."""
        try:
            self.write_means()
            self._cached.write()
        except RobustFlowError:
            pass  # The folder is read-only: the next page computes them again.

    @cached_property
    def _cached(self) -> CachedValues:
        return CachedValues(self.path, self._source)

    @cached_property
    def _means(self) -> Summary:
        return self.summarize("image")

    @cached_property
    def _source(self) -> str:
        return source_digest(self.path, self.rows_digest, self.manifest, beside=False)

    def _stored_means(self) -> Summary | None:
        if not is_current(self.path, SUMMARY, self._source):
            return None
        try:
            document = json.loads((self.path / SUMMARY).read_text(encoding="utf-8"))
            return summary_in_order(Summary.model_validate({name: document[name] for name in Summary.model_fields}))
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def planned(self) -> list[Cell]:
        """Every (sample, corruption, severity) of a complete run; clean rows as (sample, "clean", 0)."""
        return list(planned_cells(self.manifest))


def _lines(run: Run) -> list[str]:
    """Which run, its means, and what is missing."""
    title = benchmark_facts(run.benchmark).title
    samples = len(run.manifest.samples)
    truth = truth_remark(run.manifest.identity.frames.protocol)
    on = ", ".join(filter(None, (plain(title), counted(samples, sample_noun(run.benchmark)), truth)))
    head = f"{plain(run.name)} ({plain(run.setting)}) on {on}"
    means = [
        f"{name} {value:.4g}{unit}"
        for name, value, unit in (
            ("clean EPE", run.epe_clean, " px"),
            ("EPE", run.epe, " px"),
            ("CRE", run.cre, " px"),
            ("CREr", run.crer, ""),
            ("RCRE", run.rcre, " px"),
            ("clean flow", None if run.epe_clean is not None else run.summary.clean_flow_length, " px long"),
        )
        if value is not None
    ]
    summary = run.summary
    complete = "" if summary.complete else "not complete: "
    over = ", ".join(map(plain, summary.averaged_over)) or "nothing yet"
    return [head, ", ".join(means) or "nothing measured", f"{complete}mean over {over}", plain(str(run.path), None)]
