"""Multi-frame ptlflow models, which receive the same frames as in their authors' evaluations.

VideoFlow (Shi et al., ICCV 2023), MemFlow (Dong and Fu, CVPR 2024), StreamFlow (Sun et al., NeurIPS 2024), MEMFOF
(Bargatin et al., ICCV 2025), STaRFlow (Godet et al., ICPR 2020). The first pair of a sequence is handled as in the
authors' evaluation code: VideoFlow repeats the first frame once, and otherwise its window of five frames stays within
the sequence; StreamFlow's window of four frames stays within the sequence; MemFlow's memory is empty. MEMFOF repeats
the first frame, as ptlflow's data loader does. MemFlow's memory contains the last two frames, ptlflow's default; the
authors' configurations effectively use one.

SplatFlow (three frames; Wang et al., IJCV 2024) is not included: it propagates features with a CUDA kernel compiled by
cupy, so ptlflow cannot build it without cupy, and it cannot be tested against ptlflow on a CPU. With cupy,
`ptlflow:splatflow` receives only the pair and runs in its two-frame mode, which does not need splatting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.errors import UsageError
from ..conventions import check_count
from ..devices import Execution, with_execution
from ..window import Window
from .pairs import ptlflow_model, ptlflow_network

if TYPE_CHECKING:
    from ..torch.model import TorchClipModel
    from .clip_net import Reading


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
"""Number of frames before the pair. On KITTI, the authors start ten frames before the pair; on other datasets, they
start at the beginning of the sequence.
"""

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
    """Build a multi-frame ptlflow model, which does not keep state between clips."""
    clip = CLIPS[architecture]
    window = clip.window
    if before is not None:
        if not clip.streams:
            raise UsageError(f"model '{name}' requires {_frames(window)} frames; omit before")
        check_count("before", before)
        window = window._replace(before=before)

    def wrap(model: Any) -> Any:
        from .clip_net import PtlflowClipNet

        return PtlflowClipNet(model, clip.reading, clip.least, clip.twice)

    network = ptlflow_network(name, architecture, wrap, checkpoint, iterations, sha256, execution)
    from ..torch.model import TorchClipModel, TorchStreamModel

    return (TorchStreamModel if clip.streams else TorchClipModel)(network, window)


def ptlflow_factory(name: str, architecture: str) -> Callable[..., Any]:
    """A function that builds any ptlflow model, two-frame or multi-frame."""
    return partial(ptlflow_clip_model if architecture in CLIPS else ptlflow_model, name, architecture)


def _frames(window: Window) -> int:
    return window.before + 2 + window.after


videoflow_bof = ptlflow_factory("videoflow_bof", "videoflow_bof")
videoflow_mof = ptlflow_factory("videoflow_mof", "videoflow_mof")
memflow = ptlflow_factory("memflow", "memflow")
memflow_t = ptlflow_factory("memflow_t", "memflow_t")
streamflow = ptlflow_factory("streamflow", "streamflow")
memfof = ptlflow_factory("memfof", "memfof")
