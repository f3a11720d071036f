"""The package's functions for runs: evaluate a model, read a run, compare runs; the only module that both runs and
reports."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .benchmarks import Benchmark
from .datasets.registry import with_absolute_paths
from .errors import RobustFlowError, UsageError
from .models import ModelSpec
from .models.base import AnyModel
from .records.load import load_any_run
from .report.site.write import write_report
from .runs.costs import RunCost, read_cost
from .runs.run import Run
from .text import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .analysis.uncoupled import Uncoupled
    from .attacks.api import AnyAttack
    from .benchmarks.base import AnyCorruption
    from .report.comparison import Comparison
    from .runner.progress import Progress
    from .runner.setup import Setup


class Result(Run):
    """A run, and what can be made from it: comparisons, figures and pages.

    Args:
        folder: the run's folder.

    Raises:
        RunError: no run in it, or one that this version cannot read.
    """

    @property
    def cost(self) -> RunCost | None:
        """The cost of one prediction of the model, if `robustflow profile MODEL --into RUN` measured it."""
        return read_cost(self)

    def compare(
        self, other: Run | str | Path, *, level: float = 0.95, resamples: int = 4999, seed: int = 0
    ) -> Comparison:
        """Whether this run differs from another one, or that of a folder, over the same frames; see
        `robustflow.compare`."""
        from .report.comparison import compare

        return compare(self, other, level=level, resamples=resamples, seed=seed)

    def uncoupled(self) -> Uncoupled:
        """Robustness less tied to accuracy: log ratios of errors, medians over images, the increase of Fl, and the
        partial correlation of the corrupted with the clean error; see `robustflow.analysis.uncoupled`."""
        from .analysis.uncoupled import uncoupled

        return uncoupled(self.rows)

    def plot(self, kind: str = "severity", metric: str = "rcre", others: Sequence[Run] = ()) -> Figure:
        """A figure of this run, and of others alongside; see `robustflow.report.notebook.plot` for the kinds."""
        from .report.notebook import plot

        return plot([self, *others], kind, metric)

    def __repr__(self) -> str:
        return f"<Result of {plain(self.name)} on {plain(self.benchmark)}, {self.path}>"

    def _repr_html_(self) -> str:
        from .report.notebook import result_html

        return result_html(self)

    def write_summary(self) -> None:
        """Write `summary.json` and `report.html` into the run's folder."""
        self.write_means()
        self.write_report()

    def write_report(self) -> None:
        """Write `report.html`, with the existing example pictures."""
        write_report(self)


def load_run(path: str | Path) -> Result:
    """The run in a folder that `run` wrote, or in a record that `pack` wrote.

    A record is verified first; its run is in a temporary folder that is removed when the result is no longer used.

    Raises:
        RunError: no run in it, one that this version cannot read, or a record that does not verify.
        DataError: the file cannot be read.
    """
    return load_any_run(path, Result)


def evaluate(
    model: str | Path | ModelSpec | AnyModel | Callable[..., Any],
    benchmark: str | Benchmark = "demo",
    data: str | Path | None = None,
    output: str | Path | None = None,
    *,
    corruptions: AnyCorruption | Sequence[AnyCorruption] | None = None,
    severities: int | Sequence[int] | None = None,
    attacks: AnyAttack | Sequence[AnyAttack] | None = None,
    limit: int | None = None,
    subset: str | None = None,
    split: str | Path | None = None,
    data_options: dict[str, Any] | None = None,
    still: bool = False,
    seed: int = 0,
    variant: str = "default",
    severity_scale: str = "paper",
    common_draws: bool = False,
    name: str | None = None,
    workers: int | None = None,
    batch_size: int = 1,
    engine: str | None = None,
    address: str | None = None,
    timeout: float | None = None,
    allow_invalid: bool = False,
    confidence: str | None = None,
    draws: int = 1,
    examples: bool = False,
    progress: Progress | bool | None = None,
) -> Result:
    """Measure how robust a model is. A killed run can be resumed: the same call continues where it stopped.

    Args:
        model: a name (`"dis"`, `"module.path:Attribute"`) or path (a folder of flows), or any object with
            `predict(frame1, frame2) -> flow`, or a function of two frames, or a multi-frame model (`ClipModel`), which
            is given clips, or a PyTorch module (see `TorchModel`). An attribute `trained_on` ("C+T") declares its
            training sets, an attribute `name` what it is called.
        benchmark: "demo" (a real pair that needs no download), "kitti-fc", "gopro-fc", any dataset by name ("folder"
            for your own frames or video, "sintel", ...), or a `Benchmark`.
        data: the data set's folder, for benchmarks that need one.
        output: the run's folder; `runs/<benchmark>_<model>_<identity>` by default, `runs/folder-<data>_...` for your
            own frames.
        corruptions, severities, limit: run only these, one or several; a later call with others adds to the same
            folder. A corruption is a name, `"module.path:Attribute"`, or one of your own as a class or an object; the
            source of your own is part of the run's identity (docs/add-your-corruption.md).
        subset: "quick" for the fewest conditions that rank models nearly as all do, where a benchmark has such a
            subset (kitti-fc); means over it are marked as estimates. Not with `corruptions` or `severities`.
        attacks: adversarial attacks (docs/attacks.md) to run as well at these severities, one or several names, with
            options if there are any (`"pgd:steps=40"`), or your own, `"module.path:Attribute"`, a class or an object;
            without `corruptions` nothing else runs. Random noise comes with them, and no mean over corruptions includes
            them; see `Run.attack_rows`.
        split: a file naming the samples to use, one key per line; or "drive-disjoint", for KITTI 2015.
        data_options: options of a data set, for example {"render_pass": "final"}.
        still: pair every frame with itself, with a true flow of zero, so that errors are phantom motion
            (docs/still-scenes.md).
        seed: of every random draw. The same seed gives the same bytes on any machine.
        variant: of the corruptions: "default", "reference", "reference-bgr" or "paper".
        name: what the model is called in tables, figures and pages; its own name by default. It changes no number: a
            run continues under another name.
        common_draws: one draw for all five severities of a pair, so that they differ only in strength.
        severity_scale: "paper", or "calibrated" for severities that can be compared between corruptions; those that do
            not exist for a corruption are left out, and listed in `Result.left_out`.
        workers: number of processes. By default only this process, unless `timeout` is given; for a named model that
            uses one thread (`dis`, `tiny`, `farneback`) one per processor, up to 8, in runs of 50 cells or more. For a
            model on a GPU (attribute `device`) the processes that corrupt and measure, in addition to one per GPU that
            predicts, by default one per processor; with Ray one per GPU or processor of the cluster.
        batch_size: cells of one sample that a model with `predict_batch` gets in one call. It is not part of a run's
            identity: a flow may change by 1e-4 px.
        engine: "serial", "processes" or "ray"; chosen from the model's device, `workers` and `timeout` by default.
        address: of the Ray cluster: "auto", "host:port" or "ray://host:port"; None for one on this machine.
        timeout: seconds a single prediction, or batch of them, may take.
        allow_invalid: leave out and count predicted pixels that are NaN or infinite instead of failing.
        confidence: measure whether the model knows where it is wrong (docs/confidence.md): by "forward-backward"
            consistency, which costs one more prediction a cell, or as the "model" itself says
            (`predict_with_confidence`).
        draws: how often each corruption is drawn, with `seed` and the following ones; with 2 or more, rows and means
            also have the spread: the standard deviation of the flow over the draws, in pixels. Errors are those of the
            first draw.
        examples: at the end, draw the worst and the median sample into `examples/` of the run's folder, and into the
            report, which also gets the histogram of displacements if there is ground truth; a few predictions are
            repeated for it. If the examples cannot be drawn, a warning says why.
        progress: by default shown on a terminal and in a notebook; False shows none, True also prints lines to a log.
            Or an object with `start(folder, total, found)` and `advance(done)`.

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
    from .runner.compute_missing import compute_missing
    from .runner.default_folder import default_folder, warn_of_a_fresh_start
    from .runner.engines.child import refuse_unguarded_script
    from .runner.engines.choose import choose_engine
    from .runner.progress import shown
    from .runner.setup import open_benchmark, set_up
    from .runner.slider_pictures import capture_slider_pictures
    from .runs.source import RunSource
    from .runs.store import RunFolder

    refuse_unguarded_script()
    if subset is not None and (still or any(given is not None for given in (corruptions, severities, attacks))):
        raise UsageError("a subset has its own corruptions and severities; give it without these, attacks and still")
    opened = open_benchmark(benchmark, data, split, data_options, variant, still)
    within = opened if subset is None else opened.subset(subset)
    chosen = within.narrowed(corruptions, severities, limit, attacks)
    setup = set_up(
        model,
        chosen,
        seed=seed,
        variant=variant,
        severity_scale=severity_scale,
        allow_invalid=allow_invalid,
        confidence=confidence,
        draws=draws,
        common_draws=common_draws,
        name=name,
    )
    setup.model.check_batch_size(batch_size)
    compute = choose_engine(
        engine, workers, timeout, address, setup.model, (setup.dataset, setup.options), bool(chosen.attacks)
    )
    if output is None:
        output = default_folder(setup.plan, setup.model.spec, data)
        warn_of_a_fresh_start(output, setup.plan)
    folder = RunFolder(output)
    folder.lock()
    try:
        with capture_slider_pictures(setup) if examples else nullcontext(setup) as keeping:
            with shown(progress) as listener:
                compute_missing(folder, keeping, compute, batch_size, listener)
            if isinstance(benchmark, str):
                where = Path(data) if data is not None else None
                options = with_absolute_paths(benchmark, data_options or {})
                RunSource(setup.model.spec, where, options).write(folder.path)
            _draw(Result(folder.path), keeping, examples)
    finally:
        folder.unlock()
    return Result(folder.path)


def _draw(result: Result, setup: Setup, wanted: bool) -> None:
    """Draw the example pictures once the numbers are safe: no failure here costs a run its rows."""
    from .runner.cost import keep_cost
    from .runner.displacement import keep_displacement
    from .runner.examples import write_examples
    from .runs.example_list import are_current, drop_examples

    result.write_means()
    wanted = wanted and bool(result.manifest.selection.corruptions)  # attacks are not drawn
    try:
        keep_cost(result, setup.model.model)
        if wanted:
            keep_displacement(result, setup.plan.benchmark)
        if are_current(result):
            return
        drop_examples(result.path)
        if wanted:
            write_examples(result, setup)
    except RobustFlowError as error:
        warnings.warn(f"no example pictures: {error}", stacklevel=3)
    finally:
        write_report(result)
