"""Models of the library ptlflow: the paper's eight under their names, any other as `ptlflow:NAME`.

Needs the ptlflow extra when a model is built. Its import takes seconds and prints, so it is late and silenced.
"""

from __future__ import annotations

import inspect
import io
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ModelError, UsageError, unknown_name
from .input_convention import InputConvention
from .network import check_iterations, network_model, require

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .torch_model import TorchModel

_ITERATIONS = ("iters", "decoder_depth")
"""What ptlflow's models call the number of their iterations."""

_SMALLEST = {
    **dict.fromkeys(("raft", "raft_small", "gma", "csflow", "skflow", "gmflownet", "craft"), 121),
    "flowformer": 25,
}
"""Pixels a side. RAFT halves its correlation volume three times and divides by the last one's sides less one, which is
0 up to 120 pixels: NaN. Its authors evaluate nothing so small and pad to multiples of 8 only, so such frames are
refused."""

_BATCHED = ("raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer_pp")
"""Whose pairs of a batch were found not to see each other. FlowFormer's do, by 1e-4 px."""


def ptlflow_model(
    name: str,
    architecture: str,
    checkpoint: str | Path | None = None,
    *,
    iterations: int | None = None,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchModel:
    """A two-frame model of ptlflow, on whole frames; its own tiling, which a checkpoint may turn on, stays off.

    Args:
        name: of the model.
        architecture: ptlflow's name of it.
        checkpoint: ptlflow's name of a checkpoint (things, sintel, ...), a file of its authors or of ptlflow, or
            "random".
        iterations: of the recurrent update; None for ptlflow's default. The paper's evaluation takes 12.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.

    Raises:
        ModelError: ptlflow is not installed, or the model or checkpoint cannot be loaded.
        UsageError: no such model, checkpoint or number of iterations.
    """

    def wrap(model: Any) -> Any:
        from .nets.ptlflow_net import PtlflowNet

        return PtlflowNet(model, architecture in _BATCHED)

    return ptlflow_network(
        name,
        architecture,
        wrap,
        checkpoint,
        iterations=iterations,
        sha256=sha256,
        device=device,
        precision=precision,
        compile=compile,
        threads=threads,
    )


def ptlflow_network(
    name: str,
    architecture: str,
    wrap: Callable[[Any], Any],
    checkpoint: str | Path | None,
    *,
    iterations: int | None,
    sha256: str | None,
    **execution: Any,
) -> TorchModel:
    """A network of ptlflow as `wrap` makes it callable; arguments and errors as of `ptlflow_model`."""
    require("ptlflow", "ptlflow", name)
    with _silence():
        import ptlflow
    if architecture not in ptlflow.get_model_names():
        raise unknown_name("ptlflow model", architecture, ptlflow.get_model_names())
    reference = ptlflow.get_model_reference(architecture)
    options = _options(name, reference, iterations)

    def build() -> Any:
        with _silence():
            return wrap(reference(**options))

    used = next((options[key] for key in _ITERATIONS if key in options), None)
    return network_model(
        name,
        build,
        InputConvention(order="bgr", scale=1.0, smallest=_SMALLEST.get(architecture, 1)),
        checkpoint,
        source="the authors' file",
        sha256=sha256,
        published=getattr(reference, "pretrained_checkpoints", None) or {},
        settings={
            "iterations": used,
            "library": f"ptlflow {ptlflow.__version__}",
            "normalisation": "0..1, then the network's own scaling and padding",
            **({"use_tile_input": False} if "use_tile_input" in options else {}),
        },
        adapt=_adapt,
        **execution,
    )


def _options(name: str, reference: Any, iterations: int | None) -> dict[str, Any]:
    parameters = inspect.signature(reference.__init__).parameters
    options: dict[str, Any] = {"use_tile_input": False} if "use_tile_input" in parameters else {}
    if "backbone_weights" in parameters:
        options["backbone_weights"] = None  # fetched for nothing: the checkpoint replaces them
    keyword = next((key for key in _ITERATIONS if key in parameters), None)
    counted = keyword is not None and isinstance(parameters[keyword].default, int)
    if iterations is not None:
        check_iterations(iterations)
        if not counted:
            raise UsageError(f"model '{name}' has no single number of iterations; leave out iterations")
    if keyword is not None and counted:
        options[keyword] = parameters[keyword].default if iterations is None else iterations
    return options


def _adapt(net: Any, read: Checkpoint) -> Mapping[str, Any]:
    """What ptlflow keeps beside the weights of some checkpoints and sets again when it loads them.

    `train_size` only turns on the tiling of the others, but it is part of MatchFlow's network.
    """
    recorded = {}
    model = net.model
    for key, kind in (("train_avg_length", int), ("train_size", list)):
        value = read.hyper_parameters.get(key)
        if value is None or (key == "train_size" and not type(model).__name__.startswith("matchflow")):
            continue
        value = list(value) if isinstance(value, tuple) else value
        if not isinstance(value, kind):
            raise ModelError(f"{read.path}: its {key} is {value!r}; get ptlflow's own file")
        with _silence():
            setattr(model, key, value)
        recorded[key] = value
    return recorded


@contextmanager
def _silence() -> Iterator[None]:
    """Standard output belongs to the results, and what ptlflow says there helps nobody."""
    import loguru  # noqa: F401  # it keeps the stderr it finds on its first import, which must be the real one

    with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


def _of_the_paper(name: str) -> partial[TorchModel]:
    return partial(ptlflow_model, name, name, iterations=12)


raft = _of_the_paper("raft")
gma = _of_the_paper("gma")
csflow = _of_the_paper("csflow")
skflow = _of_the_paper("skflow")
gmflownet = _of_the_paper("gmflownet")
craft = _of_the_paper("craft")
flowformer = _of_the_paper("flowformer")
flowformer_pp = _of_the_paper("flowformer_pp")
