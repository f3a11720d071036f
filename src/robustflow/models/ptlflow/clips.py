"""Multi-frame models of ptlflow: which frames each is given, as its authors evaluate it.

VideoFlow (Shi et al., ICCV 2023), MemFlow (Dong and Fu, CVPR 2024), StreamFlow (Sun et al., NeurIPS 2024), MEMFOF
(Bargatin et al., ICCV 2025), STaRFlow (Godet et al., ICPR 2020). What happens at the first pair of a sequence is what
the authors' evaluation code does: VideoFlow repeats the first frame once, and its window of five otherwise stays
within the sequence; StreamFlow's window of four stays within it; MemFlow's memory is empty. MEMFOF repeats the first
frame, as ptlflow's data loader does. MemFlow's memory holds the last two frames, ptlflow's default; its authors'
configurations come down to one.

SplatFlow (three frames; Wang et al., IJCV 2024) is not among them: it carries features forward by a CUDA kernel that
cupy compiles, so ptlflow does not even build it without cupy, and it cannot be compared with its library on a CPU.
With cupy, `ptlflow:splatflow` only gets the pair: its two-frame mode, which needs no splatting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import UsageError
from ..execution import Execution, with_execution
from ..option_checks import check_count
from ..window import Window
from .pairs import ptlflow_model, ptlflow_network

if TYPE_CHECKING:
    from ..torch.clip_model import TorchClipModel
    from .clip_net import Reading


@dataclass(frozen=True)
class _ClipConvention:
    """How a network is given its clip; see `PtlflowClipNet`."""

    window: Window
    reading: Reading
    least: int
    twice: int = 0
    streams: bool = False
    """It also works with only two frames."""


_MEMORY = _ClipConvention(Window(10, 0, "short"), "memory", least=2, streams=True)
"""On KITTI the authors begin ten frames before the pair; on other data with the sequence."""

CLIPS = {
    "videoflow_bof": _ClipConvention(Window(1, 0, "repeat"), "middle", least=3),
    "videoflow_mof": _ClipConvention(Window(2, 1, "inside"), "middle", least=3, twice=5),
    "memflow": _MEMORY,
    "memflow_t": _MEMORY,
    "streamflow": _ClipConvention(Window(2, 0, "inside"), "each", least=4),
    "memfof": _ClipConvention(Window(1, 0, "repeat"), "middle", least=3),
    "starflow": _ClipConvention(Window(2, 0, "short"), "each", least=2, streams=True),
}
"""Multi-frame networks by ptlflow's name."""


@with_execution
def ptlflow_clip_model(
    name: str,
    architecture: str,
    checkpoint: str | Path | None = None,
    *,
    before: int | None = None,
    iterations: int | None = None,
    sha256: str | None = None,
    execution: Execution,
) -> TorchClipModel:
    """A multi-frame model of ptlflow. It keeps nothing from clip to clip.

    Args:
        name: of the model.
        architecture: a name of `CLIPS`.
        checkpoint, iterations, sha256: see `ptlflow_model`.
        before: for MemFlow and STaRFlow: frames before the pair, from 1; the authors' by default.
        execution: see `Execution`; its fields are options.

    Raises:
        ModelError: ptlflow is not installed, or the model or checkpoint cannot be loaded.
        UsageError: no such checkpoint or number of iterations; `before` for a network that has one number of frames.
    """
    clip = CLIPS[architecture]
    window = clip.window
    if before is not None:
        if not clip.streams:
            raise UsageError(f"model '{name}' is made for {_frames(window)} frames; leave out before")
        check_count("before", before)
        window = window._replace(before=before)

    def wrap(model: Any) -> Any:
        from .clip_net import PtlflowClipNet

        return PtlflowClipNet(model, clip.reading, clip.least, clip.twice)

    network = ptlflow_network(name, architecture, wrap, checkpoint, iterations, sha256, execution)
    from ..torch.clip_model import TorchClipModel, TorchStreamModel

    return (TorchStreamModel if clip.streams else TorchClipModel)(network, window)


def ptlflow_factory(name: str, architecture: str) -> Callable[..., Any]:
    """Builds any model of ptlflow, of two frames or more."""
    return partial(ptlflow_clip_model if architecture in CLIPS else ptlflow_model, name, architecture)


def _frames(window: Window) -> int:
    return window.before + 2 + window.after


videoflow_bof = ptlflow_factory("videoflow_bof", "videoflow_bof")
videoflow_mof = ptlflow_factory("videoflow_mof", "videoflow_mof")
memflow = ptlflow_factory("memflow", "memflow")
memflow_t = ptlflow_factory("memflow_t", "memflow_t")
streamflow = ptlflow_factory("streamflow", "streamflow")
memfof = ptlflow_factory("memfof", "memfof")
