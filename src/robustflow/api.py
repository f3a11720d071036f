"""The package's functions for runs: evaluate a model, read a run, compare runs. The only module that both runs
evaluations and writes reports."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .core.errors import RobustFlowError
from .core.text import plain
from .data.benchmarks import Benchmark
from .data.datasets.registry import with_absolute_paths
from .models import ModelRef
from .models.protocols import AnyModel
from .run.config import RunConfig
from .run.run import Run

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

    from .attacks.api import AnyAttack
    from .data.benchmarks.benchmark import AnyCorruption
    from .report.comparison import Comparison
    from .report.site.page import Figures
    from .run.costs import RunCost
    from .run.plan import Plan
    from .run.progress import Progress


class Result(Run):
    """A run, with methods for comparisons, figures and report pages.

    Args:
        folder: path of the run's folder.
        asked: manifest of the part of the run that one call asked for; by default, everything in the folder.

    Raises:
        RunError: the folder contains no run, or one that this version cannot read.
    """

    @property
    def cost(self) -> RunCost | None:
        """Return the cost of one prediction of the model, if `robustflow profile MODEL --into RUN` measured it."""
        from .run.costs import RunCost

        return RunCost.read(self)

    def compare(self, other: Run | str | Path) -> Comparison:
        """Test whether this run differs from a second run, or from the run in a folder, on the same frames; see
        `robustflow.compare`."""
        from .report.comparison import compare

        return compare(self, other)

    @property
    def frame(self) -> pl.DataFrame:
        """Return every number of this run as one table (`robustflow.stats.frame.RESULTS_SCHEMA`): a row for each
        measure, condition and severity, with its 95 % interval where one exists."""
        from .stats.frame import results_frame

        return results_frame([self])

    def plot(self, kind: str = "severity", metric: str = "rcre", others: Sequence[Run] = ()) -> Figure:
        """Return a figure of this run, optionally with other runs; see `robustflow.report.notebook.plot` for the
        kinds."""
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
        """Write `report.html`, including any existing example pictures."""
        _write_report(Run(self.path))


def load_run(path: str | Path) -> Result:
    """Read the run in a folder that `run` wrote, or in a record that `record pack` wrote. A record is verified first;
    its run is unpacked into a temporary folder, which is removed when the result is garbage-collected.

    Raises:
        RunError: the path contains no run, a run that this version cannot read, or a record that does not verify.
        DataError: the file cannot be read.
    """
    from .run.records.pack import load_any_run

    return load_any_run(path, Result)


def evaluate(
    model: str | Path | ModelRef | AnyModel | Callable[..., Any],
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
    """Measure how robust a model is. To resume an interrupted run, repeat the same call.

    Args:
        model: the model to evaluate: a name (`"dis"`, `"module.path:Attribute"`), the path of a folder of flows, any
            object with `predict(frame1, frame2) -> flow`, a function of two frames, a multi-frame model (`ClipModel`)
            that takes clips, or a PyTorch module (see `TorchModel`). An attribute `trained_on` ("C+T") declares its
            training sets; an attribute `name` sets its name.
        benchmark: the benchmark: "demo" (a real pair that needs no download), "kitti-fc", "gopro-fc", the name of a
            dataset ("folder" for your own frames or video, "sintel", ...), or a `Benchmark`.
        data: the dataset's folder, for benchmarks that need one.
        output: the run's folder; `runs/<benchmark>_<model>_<identity>` by default, `runs/folder-<data>_...` for your
            own frames.
        corruptions, severities, limit: corruptions, severities (one or more each) and number of samples to run; a later
            call with different values adds its rows to the same folder, and its result covers only what it asked for
            (`load_run` reads the whole folder). A corruption is a name, `"module.path:Attribute"`, or a user-defined
            class or object, whose source is part of the run's identity (docs/add-your-corruption.md).
        subset: "quick" for a small set of conditions whose ranking of models resembles that of the full set, for
            benchmarks that define one (kitti-fc); its means are marked as estimates. Cannot be combined with
            `corruptions`, `severities`, `attacks` or `still`.
        attacks: one or more adversarial attacks (docs/attacks.md) to run at these severities: names with optional
            settings (`"pgd:steps=40"`), or user-defined attacks as `"module.path:Attribute"`, a class or an object.
            Without `corruptions`, only attacks are run. Random noise is added as a baseline. Means over corruptions
            exclude attacks; see `Run.attack_rows`.
        split: path of a file that lists the samples to use, one key per line, or "drive-disjoint" for KITTI 2015.
        data_options: options of the dataset, for example {"render_pass": "final"}.
        still: True to pair every frame with itself, so that the true flow is zero and every error is phantom motion
            (docs/still-scenes.md).
        seed: the seed for all random draws. The same seed produces the same bytes on any machine.
        variant: the variant of the corruptions: "default", "reference", "reference-bgr" or "paper".
        name: the model's display name in tables, figures and pages; by default the model's own name. The display name
            does not affect the results: a run can be resumed under a different name.
        severity_scale: "paper", or "calibrated" for severities that are comparable across corruptions; severities that
            do not exist for a corruption are left out and listed in `Result.left_out`.
        workers: number of worker processes. By default, there are none unless `timeout` is given; but for a named
            single-threaded model (`dis`, `tiny`, `farneback`) in runs of 50 cells or more, one per processor, up to 8.
            For a model on a GPU (attribute `device`), the number of processes that corrupt and measure, in addition to
            one per GPU that predicts; by default one per processor. With Ray, one per GPU or processor of the cluster.
        batch_size: number of cells of one sample in one call of `predict_batch`, and of attacked pairs in one call to a
            model with `batched_gradients`. The batch size is not part of a run's identity, although it may change the
            flow by 1e-4 px.
        engine: the execution engine: "serial", "processes" or "ray"; chosen from the model's device, `workers` and
            `timeout` by default.
        address: address of the Ray cluster: "auto", "host:port" or "ray://host:port"; None starts a local cluster.
        timeout: time limit for a single prediction, batch or attack, in seconds.
        allow_invalid: True to omit and count predicted pixels that are NaN or infinite instead of failing.
        confidence: the source of confidence estimates to evaluate (docs/confidence.md): "forward-backward" consistency,
            which needs one more prediction per cell, or the "model" itself (`predict_with_confidence`).
        draws: number of random draws of each corruption, with `seed` and the seeds that follow it. With 2 or more, rows
            and means also contain the spread: the standard deviation of the flow over the draws, in pixels. Errors come
            from the first draw.
        examples: True to draw the worst and the median sample at the end, into `examples/` in the run's folder and into
            the report, which also shows the histogram of displacements if there is ground truth. This repeats a few
            predictions. If the examples cannot be drawn, a warning gives the reason.
        progress: True to show progress, as plain lines in a log if there is no terminal or notebook; False to hide it;
            by default, it is shown on a terminal and in a notebook. Alternatively, an object with `start(folder, total,
            finished)` and `advance(done)`.

    Returns:
        The `Result`, of what this call asked for: `epe_clean`, `cre`, `crer`, `rcre`, `table("epe")`, `rows`.

    Raises:
        UsageError, DataError, ModelError, RunError: see each class; finished rows are always kept.

    >>> import tempfile, numpy as np
    >>> still = lambda frame1, frame2: np.zeros((*frame1.shape[:2], 2), np.float32)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     evaluate(still, "demo", output=folder, corruptions=["contrast"], severities=[1]).rcre
    0.0
    """
    config = RunConfig.of(locals())
    from .core.user_script import refuse_unguarded_script
    from .pictures.examples import capture_slider_pictures
    from .run.compute_missing import compute_missing
    from .run.engines.choose import choose_engine
    from .run.progress import Silent, TerminalProgress, shown
    from .run.setup import open_selection, set_up
    from .run.source import RunSource, default_folder, warn_of_a_fresh_start
    from .run.store import RunFolder

    refuse_unguarded_script()
    plan = set_up(model, open_selection(config.selection, variant), config)
    compute = choose_engine(plan)
    if output is None:
        output = default_folder(plan, data)
        warn_of_a_fresh_start(output, plan)
    folder = RunFolder(output)
    folder.lock()
    try:
        with capture_slider_pictures(plan, folder.path) if examples else nullcontext(plan) as keeping:
            with shown(progress) as listener:
                compute_missing(folder, keeping, compute, listener)
                if isinstance(benchmark, str):
                    where = Path(data) if data is not None else None
                    options = with_absolute_paths(benchmark, data_options or {})
                    RunSource(plan.model.ref, where, options).write(folder.path)
                whole = Result(folder.path)
                whole.write_means()
                asked = whole.manifest.restricted([plan.cells()], plan.left_out())
                result = Result(folder.path, asked)
                phases = listener if isinstance(listener, TerminalProgress) else Silent()
                phases.measured(result)
                _draw(whole, keeping, examples, phases.drawing)
            return result
    finally:
        folder.unlock()


def _draw(result: Result, plan: Plan, wanted: bool, drawing: Callable[[str], None]) -> None:
    """Draw the example pictures and the page after the rows are saved, so that a failure here loses no rows."""
    from .pictures.examples import drop_examples, write_examples
    from .report.gallery.examples import are_current
    from .run.costs import keep_cost
    from .run.displacement import keep_displacement

    wanted = wanted and bool(result.manifest.corruptions)  # example pictures do not show attacks
    figures = None
    try:
        keep_cost(result, plan.model.model)
        if wanted:
            keep_displacement(result, plan.benchmark)
        if are_current(result):
            return
        drop_examples(result.path)
        if wanted:
            with closing(write_examples(result, plan)) as steps:
                for what in steps:
                    drawing(what)
                    figures = figures or _draw_figures(result)  # while a child draws the examples
    except RobustFlowError as error:
        warnings.warn(f"the example pictures could not be drawn: {error}", stacklevel=3)
    finally:
        drawing("page")
        _write_report(result, figures)
        drawing("")


def _draw_figures(run: Run) -> Figures:
    from .report.site.page import draw_figures  # imports matplotlib

    return draw_figures(run)


def _write_report(run: Run, figures: Figures | None = None) -> None:
    from .report.site.page import write_report

    write_report(run, figures)
