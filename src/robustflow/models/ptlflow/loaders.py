"""Models of the ptlflow library, under ptlflow's names. Building one requires the ptlflow extra; the import takes
several seconds and prints output, so it is deferred and silenced.

Multi-frame models receive the same frames as in their authors' evaluations: VideoFlow (Shi et al., ICCV 2023), MemFlow
(Dong and Fu, CVPR 2024), StreamFlow (Sun et al., NeurIPS 2024), MEMFOF (Bargatin et al., ICCV 2025), STaRFlow (Godet et
al., ICPR 2020). At the first pair of a sequence, VideoFlow repeats the first frame once, and otherwise its window of
five frames stays within the sequence; StreamFlow's window of four frames stays within the sequence; MemFlow's memory is
empty. MEMFOF repeats the first frame, as ptlflow's data loader does. MemFlow's memory contains the last two frames,
ptlflow's default; the authors' configurations effectively use one.

With cupy, which its CUDA kernel needs, `ptlflow:splatflow` (Wang et al., IJCV 2024) receives only the pair and runs in
its two-frame mode.
"""

from __future__ import annotations

import inspect
import io
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_origin

from ...core.arguments import check_count
from ...core.errors import ModelError, UsageError, class_and_message, unknown_name
from ..conventions import RAFT_SMALLEST, InputConvention
from ..execution import Execution
from ..protocols import Window
from ..torch.build import SOURCES, check_available, network_model

if TYPE_CHECKING:
    from ..torch.checkpoint import Checkpoint
    from ..torch.network_model import NetworkModel, TorchClipModel
    from .net import Reading


_ITERATIONS = ("iters", "decoder_depth")
"""Argument names for the number of iterations in ptlflow's models."""


def constructor_options(name: str, reference: type, iterations: int | None) -> tuple[dict[str, Any], int | None]:
    """Return the constructor arguments for predicting complete frames with the given number of iterations."""
    parameters = constructor_parameters(reference)
    # ptlflow's own loader also passes lists, and some constructors modify them.
    options: dict[str, Any] = {
        key: list(parameter.default)
        for key, parameter in parameters.items()
        if get_origin(parameter.annotation) is Sequence and isinstance(parameter.default, (list, tuple))
    }
    if "use_tile_input" in parameters:
        options["use_tile_input"] = False
    if "backbone_weights" in parameters:
        options["backbone_weights"] = None  # no need to download weights: the checkpoint replaces them
    keyword = next((key for key in _ITERATIONS if key in parameters), None)
    counted = keyword is not None and isinstance(parameters[keyword].default, int)
    if iterations is not None:
        check_count("iterations", iterations)
        if not counted:
            raise UsageError("iterations", f"model '{name}' does not have exactly one number of them; omit this option")
    if keyword is None or not counted:
        return options, None
    rounds = int(parameters[keyword].default) if iterations is None else iterations
    return options | {keyword: rounds}, rounds


def constructor_parameters(reference: type) -> dict[str, inspect.Parameter]:
    """Return the arguments of a class, including those that it passes to its base classes through `**kwargs`.

    >>> class Base:
    ...     def __init__(self, depth=3, width=64): ...
    >>> class Net(Base):
    ...     def __init__(self, width=32, **kwargs): ...
    >>> {key: parameter.default for key, parameter in constructor_parameters(Net).items()}
    {'width': 32, 'depth': 3}
    """
    merged: dict[str, inspect.Parameter] = {}
    for base in reference.__mro__:
        if "__init__" not in vars(base):
            continue
        _, *parameters = inspect.signature(vars(base)["__init__"]).parameters.values()
        kinds = {parameter.kind for parameter in parameters}
        for parameter in parameters:
            if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
                merged.setdefault(parameter.name, parameter)
        if inspect.Parameter.VAR_KEYWORD not in kinds:
            break
    return merged


_SMALLEST = {
    **dict.fromkeys(("raft", "raft_small", "gma", "csflow", "skflow", "gmflownet", "craft"), RAFT_SMALLEST),
    "flowformer": 25,
}
"""Side length in pixels below which FlowFormer and networks with RAFT's correlation return NaN or fail."""

BESIDES = {
    "splatflow": "cupy, for CUDA",
    "matchflow": "QuadTreeAttention, compiled for CUDA",
    "matchflow_raft": "QuadTreeAttention, compiled for CUDA",
    "separableflow": "GANet, compiled for CUDA",
    "scv4": "torch_scatter and faiss",
    "scv8": "torch_scatter and faiss",
    "waft_dinov3_a2": "the DINOv3 code in ./thirdparty/dinov3",
}
"""Dependencies of some ptlflow models that are not installed with ptlflow."""

CONFIDENT = ("liteflownet3", "liteflownet3_pseudoreg", "liteflownet3s", "liteflownet3s_pseudoreg")
"""Networks that return a confidence from 0 to 1 with their flow. An occlusion map (IRR-PWC, MaskFlownet, ScopeFlow) is
not treated as a confidence, and SEA-RAFT and related networks only return an error estimate in training.
"""

_SOURCE = SOURCES["ptlflow"]
BATCHED = ("raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer_pp")
"""Networks that process the pairs of a batch independently; FlowFormer's cost tokens attend to other pairs."""


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
) -> NetworkModel:
    """Build a two-frame model; its built-in tiling is off, even if a checkpoint enables it."""

    def wrap(model: Any) -> Any:
        from .net import CraftNet, FlowFormerPlusPlusNet, PtlflowNet

        adapted = {"craft": CraftNet, "flowformer_pp": FlowFormerPlusPlusNet}
        return adapted[architecture](model) if architecture in adapted else PtlflowNet(model, architecture in BATCHED)

    execution = Execution(device, precision, compile, threads)
    return ptlflow_network(name, architecture, wrap, checkpoint, iterations, sha256, execution)


def ptlflow_network(
    name: str,
    architecture: str,
    wrap: Callable[[Any], Any],
    checkpoint: str | Path | None,
    iterations: int | None,
    sha256: str | None,
    execution: Execution,
) -> NetworkModel:
    """Build a ptlflow network with the interface given by `wrap`; arguments and errors as for `ptlflow_model`."""
    check_available(name, checkpoint, "ptlflow", _SOURCE, needed=architecture not in BESIDES)
    with _silence():
        import ptlflow
    if architecture not in ptlflow.get_model_names():
        raise unknown_name("ptlflow model", architecture, ptlflow.get_model_names())
    reference = ptlflow.get_model_reference(architecture)
    options, rounds = constructor_options(name, reference, iterations)

    def build() -> Any:
        try:
            with _silence():
                return wrap(reference(**options))
        except Exception as error:
            raise _build_error(name, architecture, reference, error) from error

    if architecture in BESIDES:
        build()  # raises an error before a checkpoint is downloaded unnecessarily
    return network_model(
        name,
        build,
        InputConvention(order="bgr", scale=1.0, smallest=_SMALLEST.get(architecture, 1)),
        checkpoint,
        source=_SOURCE,
        sha256=sha256,
        published=getattr(reference, "pretrained_checkpoints", None) or {},
        settings={
            "iterations": rounds,
            "library": f"ptlflow {ptlflow.__version__}",
            "normalisation": "0..1, then the network's own scaling and padding",
            **({"use_tile_input": False} if "use_tile_input" in options else {}),
        },
        adapt=_adapt,
        confident=architecture in CONFIDENT,
        execution=execution,
    )


def is_of_ptlflow(name: str) -> bool:
    """Return whether ptlflow is installed and has a model of this name."""
    if find_spec("ptlflow") is None:
        return False
    with _silence():
        import ptlflow
    return name in ptlflow.get_model_names()


def _build_error(name: str, architecture: str, reference: Any, error: Exception) -> ModelError:
    what = class_and_message(error)
    if architecture not in BESIDES and not isinstance(error, ImportError):
        return ModelError(name, f"the model cannot be built: {what}")
    needs = BESIDES.get(architecture, "something")
    readme = Path(inspect.getfile(reference)).with_name("README.md")
    return ModelError(name, f"the model needs {needs}, which is not installed with ptlflow ({what}); see {readme}")


def _adapt(net: Any, read: Checkpoint) -> Mapping[str, Any]:
    """Restore settings that ptlflow stores in some checkpoints and applies when it loads the weights."""
    recorded = {}
    model = net.model
    for key, kind in (("train_avg_length", int), ("train_size", list)):
        value = read.hyper_parameters.get(key)
        if value is None or (key == "train_size" and not type(model).__name__.startswith("matchflow")):
            continue
        value = list(value) if isinstance(value, tuple) else value
        if not isinstance(value, kind):
            raise ModelError(read.path, f"its {key} is {value!r}; use the file published by ptlflow")
        with _silence():
            setattr(model, key, value)
        recorded[key] = value
    return recorded


@contextmanager
def _silence() -> Iterator[None]:
    """Suppress ptlflow's output: standard output is reserved for results."""
    import loguru  # noqa: F401  # it keeps the stderr it finds on its first import, which must be the real one

    with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


@dataclass(frozen=True)
class _ClipConvention:
    """How a network receives its clip; see `PtlflowClipNet`."""

    window: Window
    reading: Reading
    least: int
    twice: int = 0
    streams: bool = False
    """Whether the network also works with only two frames."""


_MEMORY = _ClipConvention(Window(10, 0, "short"), "memory", least=2, streams=True)
"""Ten frames before the pair, as the authors on KITTI; elsewhere they start at the beginning of the sequence."""

CLIPS = {
    "videoflow_bof": _ClipConvention(Window(1, 0, "repeat"), "middle", least=3),
    "videoflow_mof": _ClipConvention(Window(2, 1, "inside"), "middle", least=3, twice=5),
    "memflow": _MEMORY,
    "memflow_t": _MEMORY,
    "streamflow": _ClipConvention(Window(2, 0, "inside"), "each", least=4),
    "memfof": _ClipConvention(Window(1, 0, "repeat"), "middle", least=3),
    "starflow": _ClipConvention(Window(2, 0, "short"), "each", least=2, streams=True),
}
"""Multi-frame networks, keyed by their names in ptlflow."""


def ptlflow_clip_model(
    name: str,
    architecture: str,
    checkpoint: str | Path | None = None,
    *,
    before: int | None = None,
    iterations: int | None = None,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchClipModel:
    """Build a multi-frame ptlflow model, which does not keep state between clips."""
    clip = CLIPS[architecture]
    window = clip.window
    if before is not None:
        if not clip.streams:
            frames = window.before + 2 + window.after
            raise UsageError("before", f"model '{name}' requires {frames} frames; omit this option")
        check_count("before", before)
        window = window._replace(before=before)

    def wrap(model: Any) -> Any:
        from .net import PtlflowClipNet

        return PtlflowClipNet(model, clip.reading, clip.least, clip.twice)

    execution = Execution(device, precision, compile, threads)
    network = ptlflow_network(name, architecture, wrap, checkpoint, iterations, sha256, execution)
    from ..torch.network_model import TorchClipModel, TorchStreamModel

    return (TorchStreamModel if clip.streams else TorchClipModel)(network, window)


def ptlflow_loader(name: str, architecture: str) -> Callable[..., Any]:
    """Return the function that loads a ptlflow model, two-frame or multi-frame, with its options."""
    return partial(ptlflow_clip_model if architecture in CLIPS else ptlflow_model, name, architecture)


raft = partial(ptlflow_model, "raft", "raft", iterations=12)
gma = partial(ptlflow_model, "gma", "gma", iterations=12)
csflow = partial(ptlflow_model, "csflow", "csflow", iterations=12)
skflow = partial(ptlflow_model, "skflow", "skflow", iterations=12)
gmflownet = partial(ptlflow_model, "gmflownet", "gmflownet", iterations=12)
craft = partial(ptlflow_model, "craft", "craft", iterations=12)
flowformer = partial(ptlflow_model, "flowformer", "flowformer", iterations=12)
flowformer_pp = partial(ptlflow_model, "flowformer_pp", "flowformer_pp", iterations=12)
"""The paper's models, which run 12 iterations."""
videoflow_bof = ptlflow_loader("videoflow_bof", "videoflow_bof")
videoflow_mof = ptlflow_loader("videoflow_mof", "videoflow_mof")
memflow = ptlflow_loader("memflow", "memflow")
memflow_t = ptlflow_loader("memflow_t", "memflow_t")
streamflow = ptlflow_loader("streamflow", "streamflow")
memfof = ptlflow_loader("memfof", "memfof")
