"""The class `Run`: the contents of a run folder. Write a run's rows as one file for other programs."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import polars as pl

from ..core.errors import RobustFlowError, RunError, unknown_name
from ..core.files import json_bytes
from ..core.text import counted, plain, text_cell
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import sample_noun, truth_remark
from ..metrics.rows import CLEAN, ROW_SCHEMA_VERSION
from ..metrics.summary import Averaging, Summary
from ..models.catalog import methods
from .aggregate import summarize, summary_in_order
from .cells import UNEVEN, Cell
from .identity import Provenance
from .manifest import Manifest
from .staleness import CachedValues, is_current, source_digest, write_made
from .store import RunFolder

SUMMARY = "summary.json"

Cached = TypeVar("Cached")


class Run:
    """The results of a run, finished or not."""

    record = ""

    def __init__(self, folder: str | Path, asked: Manifest | None = None) -> None:
        self._folder = RunFolder(folder)
        self.path = self._folder.path
        self._asked = asked
        manifest = asked or self._folder.manifest()
        if manifest is None:
            raise RunError(f"{self.path} is not a run folder (it has no manifest.json); give a folder written by 'run'")
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
    def summary(self) -> Summary:
        """Return the means over the corruptions of this run, the paper's means, and the missing cells."""
        return self._stored_means() or self._means

    def summarize(self, averaging: Averaging = "image") -> Summary:
        """Return means averaged as in the paper ("image"), or over the pixels of all images together ("pixel")."""
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
        return self.summary.epe_clean

    @property
    def epe(self) -> float | None:
        """Return the mean end-point error over severities and corruptions, in pixels; None without ground truth."""
        return self.summary.epe

    @property
    def cre(self) -> float | None:
        """Return the Corruption Robustness Error in pixels (paper Eq. 1); None without ground truth."""
        return self.summary.cre

    @property
    def crer(self) -> float | None:
        """Return the Corruption Robustness Error ratio, CRE / clean EPE (paper Eq. 2); None without ground truth."""
        return self.summary.crer

    @property
    def rcre(self) -> float | None:
        """Return the Relative Corruption Robustness Error in pixels (paper Eq. 3)."""
        return self.summary.rcre

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
        return self.manifest.judged().provenance

    def table(self, metric: str = "epe") -> pl.DataFrame:
        """Return a table of one metric, corruption x severity, in the paper's order."""
        return self.summary.table(metric)

    @property
    def left_out(self) -> dict[str, tuple[int, ...]]:
        """Return the requested severities that do not exist on the run's severity scale, by corruption; no mean
        includes them."""
        return self.manifest.left_out

    def document(self) -> dict[str, Any]:
        """Return the content of `summary.json`: means by the paper's averaging, pooled means, the run, and its setting.
        Always computed from the rows."""
        return {
            **self._means.model_dump(),
            "pooled": self.summarize("pixel").model_dump(),
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
        elif not is_current(self.path, SUMMARY, self._source):
            write_made(self.path, SUMMARY, json_bytes(self.document()), self._source)

    def cached_value(self, name: str, kind: type[Cached], make: Callable[[], Cached]) -> Cached:
        """Return a value that is costly to compute, from the cache if the cached value was computed from the same
        rows.
        """
        return self._cached.get(name, kind, make)

    def has_cached_value(self, name: str) -> bool:
        """Return whether such a value is already cached."""
        return name in self._cached

    def keep(self) -> None:
        """Store the means and the values computed so far with the run, if its folder is writable; a page about
        many runs then does not need to read their rows."""
        if self._asked is not None:
            return  # the folder's files describe all its rows
        try:
            self.write_means()
            self._cached.write()
        except RobustFlowError:
            pass  # The folder is read-only, so the next page computes the values again.

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
        """Return every (sample, corruption, severity) of a complete run; clean rows as (sample, "clean", 0)."""
        return list(self._planned())

    def _planned(self) -> Iterator[Cell]:
        return chain.from_iterable(part.corrupted() for part in self.manifest.planned)


def _lines(run: Run) -> list[str]:
    """Describe the run, its means, and the missing cells."""
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
            ("photometric error", None if run.epe_clean is not None else run.summary.photometric, " grey levels"),
        )
        if value is not None
    ]
    summary = run.summary
    complete = "" if summary.complete else "not complete: "
    over = ", ".join(map(plain, summary.averaged_over)) or "nothing yet"
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
