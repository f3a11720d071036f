"""Run a model over a benchmark: plan, compute what is missing, write rows, summarise."""

from __future__ import annotations

import re
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from .benchmarks import Benchmark, load_benchmark
from .corruptions import load_corruption
from .datasets.base import Dataset, FromClips
from .errors import RobustFlowError, UsageError, unknown_name
from .models import ModelSpec
from .models.base import AnyModel, BatchedFlowModel, ClipModel, model_identity
from .models.loading import as_model
from .models.provenance import DECLARED, Training, training_of
from .models.window import Window
from .runner.clip import window_on
from .runner.displacement import keep_displacement
from .runner.engines.base import Done, Job
from .runner.engines.processes import processes, refuse_unguarded_script
from .runner.engines.serial import serial
from .runner.examples import write_examples
from .runner.same_model import check_same_model
from .runs.example_record import are_current, drop_examples
from .runs.manifest import now, open_manifest
from .runs.plan import Plan, Settings, Unit, left_out_sentence, unfinished_samples
from .runs.run import Result
from .runs.source import Source
from .runs.store import RunFolder

ENGINES = ("serial", "processes")


class Progress(Protocol):
    """Told what happens; the command line shows it, a library user may ignore it."""

    def start(self, folder: Path, total: int, found: int) -> None: ...

    def advance(self, done: Done) -> None: ...


class _Silent:
    def start(self, folder: Path, total: int, found: int) -> None:
        pass

    def advance(self, done: Done) -> None:
        pass


def evaluate(
    model: str | Path | ModelSpec | AnyModel | Callable[..., Any],
    benchmark: str | Benchmark = "demo",
    data: str | Path | None = None,
    output: str | Path | None = None,
    *,
    corruptions: Sequence[str] | None = None,
    severities: Sequence[int] | None = None,
    limit: int | None = None,
    split: str | Path | None = None,
    data_options: dict[str, Any] | None = None,
    seed: int = 0,
    variant: str = "default",
    severity_scale: str = "paper",
    workers: int = 1,
    batch_size: int = 1,
    engine: str | None = None,
    timeout: float | None = None,
    allow_invalid: bool = False,
    examples: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Measure how robust a model is. Resumable: the same call goes on where a killed one stopped.

    Args:
        model: a name (`"dis"`, `"module.path:Attribute"`) or path (a folder of flows), or any object with
            `predict(frame1, frame2) -> flow`, or a function of two frames, or a multi-frame model (`ClipModel`), which
            is given clips. An attribute `trained_on` ("C+T") declares its training sets.
        benchmark: "demo" (a real pair that needs no download), "kitti-fc", "gopro-fc", any dataset by name ("folder"
            for your own frames or video, "sintel", ...), or a `Benchmark`.
        data: the data set's folder, for benchmarks that need one.
        output: the run's folder; `runs/<benchmark>_<model>_<identity>` by default.
        corruptions, severities, limit: run only these; a later call with others adds to the same folder.
        split: a file naming the samples to use, one key a line.
        data_options: of a dataset, for example {"render_pass": "final"}.
        seed: of every random draw. The same seed gives the same bytes on any machine.
        variant: of the corruptions: "default", "reference" or "paper".
        severity_scale: "paper", or "calibrated" for severities that can be compared between corruptions; those that
            a corruption does not have on it are left out, and named in `Result.left_out`.
        workers: processes; 1 stays in this process unless `timeout` is given.
        batch_size: severities of one corruption and sample that a model with `predict_batch` gets in one call. It is
            no part of a run's identity: a flow may change by 1e-4 px.
        engine: "serial" or "processes"; chosen from `workers` and `timeout` by default.
        timeout: seconds a single prediction, or batch of them, may take.
        allow_invalid: leave out and count predicted pixels that are NaN or infinite instead of failing.
        examples: at the end, draw the worst and the median sample into `examples/` of the run's folder, and into the
            report, which also gets the histogram of displacements where there is ground truth; a few predictions are
            made again. Where they cannot be drawn, a warning says why.

    Returns:
        The `Result`: `epe_clean`, `cre`, `crer`, `rcre`, `table("epe")`, `rows`.

    Raises:
        UsageError, DataError, ModelError, RunError: see each class; finished work is kept in every case.

    >>> import tempfile, numpy as np
    >>> still = lambda frame1, frame2: np.zeros((*frame1.shape[:2], 2), np.float32)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     evaluate(still, "demo", output=folder, corruptions=["contrast"], severities=[1]).rcre
    0.0
    """
    refuse_unguarded_script()
    chosen = load_benchmark(benchmark, data, split, data_options) if isinstance(benchmark, str) else benchmark
    if isinstance(chosen.dataset, FromClips):
        chosen = replace(chosen, dataset=chosen.dataset.with_variant(variant))
    chosen = chosen.narrowed(corruptions, severities, limit)
    for name in chosen.corruptions:
        load_corruption(name, variant, severity_scale)
    if chosen.closed and severity_scale != "paper":
        raise UsageError(
            "these frames were corrupted beforehand, at the paper's severities; leave out --severity-scale, "
            "or give the uncorrupted data"
        )
    spec, identity, training, window = _identify(model, chosen.dataset, batch_size)
    psf_source = load_corruption("psf_blur", variant).source
    settings = Settings(seed, variant, allow_invalid, severity_scale, psf_source, window)
    plan = Plan(chosen, settings, identity, training.record(chosen.name))
    if plan.left_out() and len(plan.units()) == len(chosen.keys):
        raise UsageError(
            f"nothing to run: {left_out_sentence(plan.left_out())}; choose others, or the paper's --severity-scale"
        )
    run = _engine(engine, workers, timeout)
    folder = RunFolder(output if output is not None else _default_output(plan, spec))
    folder.lock()
    try:
        job = Job(chosen.dataset, spec, plan.settings, folder.path, batch_size)
        _fill(folder, plan, job, run, progress or _Silent())
        if isinstance(benchmark, str):
            named = spec if isinstance(spec, ModelSpec) else None
            Source(named, Path(data) if data is not None else None, data_options or {}).write(folder.path)
        _draw(Result(folder.path), job, chosen, examples)
    finally:
        folder.unlock()
    return Result(folder.path)


def _draw(result: Result, job: Job, benchmark: Benchmark, wanted: bool) -> None:
    """The example pictures, when the numbers are safe: nothing that happens here costs a run its rows."""
    result.write_means()
    try:
        if wanted:
            keep_displacement(result, benchmark)
        if are_current(result):
            return
        drop_examples(result.path)
        if wanted:
            model = job.model.load() if isinstance(job.model, ModelSpec) else job.model
            write_examples(result, job.dataset, model, job.settings)
    except RobustFlowError as error:
        warnings.warn(f"no example pictures: {error}", stacklevel=3)
    finally:
        result.write_report()


def _fill(
    folder: RunFolder,
    plan: Plan,
    job: Job,
    run: Callable[[Job, list[Unit]], Iterator[Done]],
    progress: Progress,
) -> None:
    manifest = open_manifest(folder, plan)
    if not isinstance(job.model, ModelSpec) and "object" in plan.model_identity:
        check_same_model(folder, job, plan.benchmark.keys)
    folder.write_manifest(manifest)
    cells = folder.tidy()
    folder.settle(manifest["samples"], unfinished_samples(manifest, cells), cells)
    units = plan.missing(cells)
    progress.start(folder.path, len(plan.units()), len(plan.units()) - len(units))
    left = Counter(unit.key for unit in units)
    seconds: dict[str, float] = dict(manifest.get("seconds", {}))
    start = time.perf_counter()
    for done in run(job, units):
        folder.write_rows(done.unit, done.rows)
        left[done.unit.key] -= 1
        if not left[done.unit.key]:
            folder.finish_sample(done.unit.key)
        for kind, spent in done.seconds.items():
            seconds[kind] = round(seconds.get(kind, 0.0) + spent, 3)
        progress.advance(done)
    folder.pack()
    seconds["wall"] = round(seconds.get("wall", 0.0) + time.perf_counter() - start, 3)
    if isinstance(job.dataset, FromClips):
        manifest["clips"] = job.dataset.clip_records()
    folder.write_manifest({**manifest, "seconds": seconds, "finished": now()})


def _identify(
    model: Any, dataset: Dataset, batch_size: int
) -> tuple[ModelSpec | AnyModel, dict[str, Any], Training, Window | None]:
    if isinstance(model, str | Path):
        model = ModelSpec(str(model))
    if isinstance(model, ModelSpec):
        loaded = model.load()
        identity = model.identity(loaded)
        _check_batch_size(batch_size, loaded)
        declared = dict(model.options).get(DECLARED, getattr(loaded, DECLARED, None))
        return model, identity, training_of(identity, declared), window_on(loaded, dataset)
    found = as_model(model, f"the model {model!r}")
    _check_batch_size(batch_size, found)
    identity = model_identity(found)
    return found, identity, training_of(identity, getattr(found, DECLARED, None)), window_on(found, dataset)


def _check_batch_size(batch_size: int, model: AnyModel) -> None:
    if batch_size < 1:
        raise UsageError(f"a batch of {batch_size} pairs cannot be predicted: give 1 or more")
    if batch_size > 1 and isinstance(model, ClipModel):
        raise UsageError("a multi-frame model predicts one clip at a time; leave out --batch-size")
    if batch_size > 1 and not isinstance(model, BatchedFlowModel):
        raise UsageError(
            "this model predicts one pair at a time (it has no method predict_batch); leave out --batch-size"
        )


def _engine(name: str | None, workers: int, timeout: float | None) -> Callable[[Job, list[Unit]], Iterator[Done]]:
    if workers < 1:
        raise UsageError(f"{workers} workers cannot work: give 1 or more")
    if timeout is not None and timeout <= 0:
        raise UsageError(f"a timeout of {timeout:g} s lets no model answer: give more than 0")
    if name is None:
        name = "processes" if workers > 1 or timeout is not None else "serial"
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    if name == "processes":
        return lambda job, units: processes(job, units, max(1, min(workers, len(units))), timeout)
    if workers > 1 or timeout is not None:
        raise UsageError("the serial engine has one worker and cannot stop a model that hangs; use --engine processes")
    return serial


def _default_output(plan: Plan, model: Any) -> Path:
    name = model.name if isinstance(model, ModelSpec) else plan.model_identity.get("name", "model")
    slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", str(name)).strip("-.")[-40:] or "model"
    return Path("runs") / f"{plan.benchmark.name}_{slug}_{plan.digest()[:8]}"
