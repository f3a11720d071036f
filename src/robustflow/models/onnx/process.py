"""Run an untrusted ONNX network in a child process with limits on its memory and time.

An ONNX file contains no code, but a graph of a few bytes may request any amount of memory, or loop for ever inside
onnxruntime, where Python cannot interrupt it.
"""

from __future__ import annotations

import os
import resource
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ...core.arguments import check_count, check_positive
from ...core.errors import ModelError, RunError, unknown_name
from ...core.paths import user_path
from ...core.plugins import require
from ...core.processes import Child
from ...core.types import Flow, Frame
from ..conventions import MOST_THREADS, InputConvention, named_convention
from ..model_file import require_file
from ..pair_network import PairNetwork

_GIB = 2**30


class OnnxModel(PairNetwork):
    """A network in an ONNX file, in a process that is limited in memory and time; satisfies `FlowModel`."""

    def __init__(
        self,
        checkpoint: str | Path | None = None,
        *,
        order: str = "rgb",
        scaling: str = "0-1",
        multiple: int = 8,
        layout: str | None = None,
        inputs: str | None = None,
        output: str | None = None,
        sha256: str | None = None,
        device: str = "cpu",
        threads: int = 1,
        memory_limit: float | None = None,
        time_limit: float = 300,
    ) -> None:
        if checkpoint is None:
            raise ModelError("onnx", "the model needs a file: pass an .onnx file as --checkpoint or --model")
        check_count("threads", threads, most=MOST_THREADS)
        for name, limit in (("memory_limit", memory_limit), ("time_limit", time_limit)):
            if limit is not None:
                check_positive(name, limit)
        self.device = _parse_device(device)
        named_convention(order=order, scaling=scaling, multiple=multiple)  # check the options before reading the file
        self._path = user_path(checkpoint)
        require_file(self._path, "file; pass the path of the exported network")
        for library in ("onnxruntime", "onnx"):
            require(library, "model 'onnx'")
        self._memory, self._time = memory_limit, time_limit
        self._options = {
            "order": order,
            "scaling": scaling,
            "multiple": multiple,
            "layout": layout,
            "inputs": inputs,
            "output": output,
            "sha256": sha256,
            "device": self.device,
            "threads": threads,
        }
        self._start()

    def identity(self) -> dict[str, Any]:
        """Return what affects the results: the files' hashes, the input convention, and the execution settings."""
        return self._identity

    @property
    def _batches_pairs(self) -> bool:
        return self._in_batches

    def run(self, frames1: list[Frame], frames2: list[Frame]) -> list[Flow]:
        """Call the network once for pairs of equal size; the result is the same as from `predict_batch`."""
        if self._child is None:
            self._start()
        assert self._child is not None
        self._child.send((frames1, frames2))
        flows: list[Flow] = self._receive("a prediction")
        return flows

    def _start(self) -> None:
        self._child: Child | None = Child(serve_network, self._path, self._options, self._memory, runs_script=False)
        self._identity: dict[str, Any]
        self.convention: InputConvention
        self._identity, self.convention, self._in_batches = self._receive("loading")

    def _receive(self, doing: str) -> Any:
        """Return the answer of the child; after an error or Ctrl-C, it is ended, and the next call starts a new one."""
        child, self._child = self._child, None
        assert child is not None
        try:
            if not child.pipe.poll(self._time):
                raise ModelError(self._path, f"{doing} took longer than {self._time:g} s; set -O time_limit=SECONDS")
            more = "allow more with -O memory_limit=GIB"
            value = child.receive(doing, more, f"lack of memory is the usual cause; {more}")[1]
        except BaseException as error:
            child.end()
            if isinstance(error, RunError):
                raise ModelError(self._path, str(error)) from error
            raise
        self._child = child
        return value


def serve_network(pipe: Connection, path: Path, options: dict[str, Any], memory: float | None) -> None:
    """Load a network and predict pairs; the main function of its process."""
    from .network import OnnxNetwork

    on_cpu = options["device"] == "cpu"  # CUDA reserves more address space than the machine has memory

    def limit_memory(default: int) -> None:
        if on_cpu:
            _allow(default if memory is None else int(memory * _GIB))

    limit_memory(2 * _GIB + 4 * path.stat().st_size)
    network = OnnxNetwork(path, **options)
    pipe.send(("loaded", (network.identity(), network.convention, network._batches_pairs)))
    while True:
        frames1, frames2 = pipe.recv()
        pixels = frames1[0].shape[0] * frames1[0].shape[1]
        limit_memory(_GIB // 2 + 2048 * pixels + pixels**2 // 500)
        pipe.send(("flows", network.run(frames1, frames2)))


def _allow(size: int) -> None:
    """Limit the memory of this process to `size` bytes more than it uses now."""
    used = int(Path("/proc/self/statm").read_text().split()[5]) * os.sysconf("SC_PAGESIZE")
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    limit = used + size
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard < 0 else min(limit, hard), hard))


def _parse_device(device: str) -> str:
    kind, _, number = str(device).partition(":")
    if kind not in ("cpu", "cuda") or (number and not (kind == "cuda" and number.isdecimal())):
        raise unknown_name("device for onnxruntime", str(device), ("cpu", "cuda", "cuda:0"))
    return str(device)
