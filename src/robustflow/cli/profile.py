"""`robustflow profile`: measure the cost of models, and compare it with the paper's table."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..core.arguments import parse_size
from ..core.errors import UsageError
from ..core.output import echo
from ..core.plugins import require
from ..core.text import plain
from . import complete
from .options import model_options, refuse_unused, shared

if TYPE_CHECKING:
    from ..models.profile import Counts, PredictionCost


@shared("option", "device", "precision")
def profile(
    context: typer.Context,
    models: Annotated[
        list[str] | None,
        Argument(metavar="MODEL", autocompletion=complete.models, help="Names of networks; none with --paper."),
    ] = None,
    size: Annotated[str, Option(help="Frame size, HEIGHTxWIDTH.")] = "432x720",
    iterations: Annotated[int | None, Option(help="Number of iterations, for iterative models [12].")] = None,
    repeat: Annotated[int, Option(help="Number of timed predictions; 0 for no timing.")] = 1,
    into: Annotated[Path | None, Option(metavar="RUN", help="Also store the cost in a run of this model.")] = None,
    paper: Annotated[bool, Option("--paper", help="Print the paper's Tab. 3 beside our counts; needs 8 GB.")] = False,
    **given: Any,
) -> None:
    """Count the parameters and multiply-accumulates (MACs) of models, and time their predictions.

    The weights are random unless -O checkpoint=FILE is given; they do not affect the cost. "as thop" is
    the count in tables and pages and in the paper's, which calls it FLOPs; it omits matrix products.

    \b
    Examples:
      robustflow profile raft
      robustflow profile raft gma flowformer --device cuda --size 375x1242
      robustflow profile raft --into runs/kitti-fc_raft_1a2b3c4d
      robustflow profile --paper
    """

    if paper:
        refuse_unused(context, set(context.params) - {"paper", "models"}, "with --paper")
    require("torch", "profiling")
    if bool(models) == paper:
        raise UsageError("--paper", "give a model to profile, or --paper alone")
    if paper:
        _print_paper()
        return
    if len(models or ()) > 1 and into is not None:
        raise UsageError("--into", "stores the cost of a single model; give one model")
    if repeat < 0:
        raise UsageError("--repeat", f"{repeat}: give 1 or more, or 0 for no timing")
    options = dict(model_options(given)) | ({} if iterations is None else {"iterations": iterations})
    costs = [(name, *_print_model(name, size, repeat, options, into)) for name in models or ()]
    if len(costs) > 1:
        _print_side_by_side(costs)


def _print_model(
    name: str, size: str, repeat: int, options: dict[str, Any], into: Path | None
) -> "tuple[Counts, PredictionCost | None]":
    from ..models import ModelRef
    from ..models.catalog import entries_of, methods
    from ..models.profile import count_prediction, measure_prediction, network_of
    from ..models.tiling import TiledModel
    from ..models.torch.build import RANDOM
    from ..run.costs import RunCost, check_profiled_model
    from ..run.run import Run

    run = None if into is None else Run(into)
    height, width = parse_size(size)
    method = methods().get(name)
    learns = bool(entries_of(name)) or (method is not None and method.type != "knowledge")
    asked = {**({"checkpoint": RANDOM} if learns else {}), **options}
    model: Any = ModelRef.parse(name, tuple(asked.items())).load()
    network = network_of(model)
    if run is not None:
        check_profiled_model(run, model.identity())
    tiles, tile = model.tiles(height, width) if isinstance(model, TiledModel) else (1, (height, width))
    fitted = network.convention.fitted_size(*tile)
    counts = count_prediction(model, height, width)
    rounds = network.identity().get("iterations")
    about = f"{name}, frames of {height}x{width}, network input 1x3x{fitted[0]}x{fitted[1]}"
    about += f", {tiles} tiles" if tiles > 1 else ""
    echo(about + (f", {rounds} iterations" if rounds else ""))
    echo(f"parameters   {counts.parameters / 1e6:.3f} M, as thop {counts.thop_parameters / 1e6:.3f} M")
    echo(f"MACs         {counts.macs / 1e9:.2f} G, as thop {counts.thop_macs / 1e9:.2f} G")
    measured = measure_prediction(model, height, width, repeat) if repeat else None
    if measured is not None:
        kind = "of tensors" if measured.device.startswith("cuda") else "of the whole process"
        echo(f"one pair     {measured.seconds:.2f} s on {measured.device}")
        echo(f"peak memory  {measured.peak_bytes / 2**30:.2f} GiB {kind}")
    if run is not None:
        facts = asdict(counts) | (asdict(measured) if measured is not None else {})
        cost = RunCost(run=run.manifest.identity_digest, height=height, width=width, iterations=rounds, **facts)
        echo(f"written to   {cost.write(run.path)}")
    return counts, measured


def _print_side_by_side(costs: "list[tuple[str, Counts, PredictionCost | None]]") -> None:
    line = "{:20s} {:>12s} {:>10s} {:>11s} {:>9s} {:>11s}"
    echo("\n" + line.format("model", "params (M)", "MACs (G)", "as thop (G)", "pair (s)", "peak (GiB)"))
    for name, counts, measured in costs:
        timed = ("-", "-") if measured is None else (f"{measured.seconds:.2f}", f"{measured.peak_bytes / 2**30:.2f}")
        counted = f"{counts.parameters / 1e6:.3f}", f"{counts.macs / 1e9:.2f}", f"{counts.thop_macs / 1e9:.2f}"
        echo(line.format(plain(name, 20), *counted, *timed))


def _print_paper() -> None:
    from ..models.profile import count_as_the_paper
    from ..run.costs import COUNTED_SIZE
    from ..stats.published.tables import published_costs

    line = "{:13s} {:>9s} {:>7s} {:>7s} {:>7s} {:>7s} {:>8s} {:>8s} {:>7s} {:>8s}"
    echo(line.format("", "", "params", "(M)", "", "", "MACs", "(G)", "", "").rstrip())
    echo(line.format("model", "input", "paper", "as thop", "diff", "true", "paper", "as thop", "diff", "true"))
    costs = published_costs()
    for method, size, counts in count_as_the_paper(costs, COUNTED_SIZE):
        if isinstance(counts, str):
            echo(f"{method:13s} {counts}")
            continue
        published = {name: float(costs[method][name]) for name in ("parameters_m", "flops_g")}
        parameters, macs = counts.thop_parameters / 1e6, counts.thop_macs / 1e9
        cells = (
            *(
                f"{published['parameters_m']:.2f}",
                f"{parameters:.3f}",
                f"{parameters - published['parameters_m']:+.3f}",
            ),
            f"{counts.parameters / 1e6:.3f}",
            *(f"{published['flops_g']:.1f}", f"{macs:.2f}", f"{macs - published['flops_g']:+.2f}"),
            f"{counts.macs / 1e9:.2f}",
        )
        echo(line.format(method, "x".join(map(str, size)), *cells))
    echo("12 iterations. The paper truncates its numbers; its FLOPs are thop's MACs.")
    echo("See docs/design/profiling.md for the remaining differences.")
