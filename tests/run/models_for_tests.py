"""Models whose behaviour a run must handle; they are loaded by name, like a user's own model."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import time
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np

from robustflow.testing import TexturePairs

from .processes import wait_until


class Sizes(TexturePairs):
    """Pairs of several sizes; the largest is neither first nor last."""

    def load(self, key):
        side = (24, 60, 40)[int(key) % 3]
        return TexturePairs(self._count, (side, side + 8)).load(key)


class NotRestored(TexturePairs):
    """Cannot be unpickled."""

    def __setstate__(self, state):
        raise ValueError("no state")


class KillsItsReader(TexturePairs):
    """Kills a process that reads its second pair, unless it is the run's main process."""

    def load(self, key):
        if key == "1" and multiprocessing.parent_process() is not None:
            os._exit(18)
        return super().load(key)


class Logged:
    """Records every prediction in the file named by PREDICTION_LOG. The flow depends on the request, so that mixed-up
    rows are detected.
    """

    def __init__(self, shape: str = "500x741", marks: str = "", pause: float = 0.0) -> None:
        self._log = os.environ["PREDICTION_LOG"]
        self._shape = tuple(int(side) for side in shape.split("x"))
        self._marks = marks
        self._pause = pause

    def identity(self) -> dict[str, str]:
        return {"name": "logged"}

    def lookup(self, key: str, corruption: str, severity: int) -> np.ndarray:
        if self._marks:  # a folder
            Path(self._marks, key).touch()
            wait_until(Path(self._marks, {"0": "1", "1": "rows of 0"}[key]).exists)
        time.sleep(self._pause)
        with open(self._log, "a") as log:
            log.write(f"{os.getpid()} {key} {corruption} {severity}\n")
        value = zlib.crc32(f"{key} {corruption} {severity}".encode()) % 1000
        return np.full((*self._shape, 2), value / 100, np.float32)


class FiveFrames:
    """A multi-frame model. Its flow depends on every pixel of every frame and on their order, by integer arithmetic."""

    window = (2, 1)

    def __init__(self, device: str = "") -> None:
        if device:
            self.device = device

    def identity(self) -> dict[str, str]:
        return {"name": "five_frames"}

    def predict_clip(self, frames: tuple[np.ndarray, ...], index: int) -> np.ndarray:
        assert len(frames) == 5
        assert index == 2
        u = sum((place + 1) * frame[..., 0].astype(np.int32) for place, frame in enumerate(frames))
        v = sum((place - 2) * frame[..., 1].astype(np.int32) for place, frame in enumerate(frames))
        return np.stack([u, v], axis=2).astype(np.float32) / 64


class Sure:
    """Predicts flow from the pixel values, with higher confidence at brighter pixels; `spoil` is "size" or "nan", a
    fault of the confidence. With a device, the model is moved to a separate process."""

    def __init__(self, spoil: str = "", device: str = "") -> None:
        self.spoil = spoil
        if device:
            self.device = device

    def identity(self) -> dict[str, str]:
        return {"name": "sure", "spoil": self.spoil}

    def predict(self, frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
        return np.stack([frame1[..., 0] / np.float32(64), frame2[..., 1] / np.float32(-32)], axis=2)

    def predict_batch(self, frames1: list[np.ndarray], frames2: list[np.ndarray]) -> list[np.ndarray]:
        return list(map(self.predict, frames1, frames2))

    def predict_with_confidence(self, frame1: np.ndarray, frame2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        confidence = frame1[..., 0].astype(np.float32)
        if self.spoil == "size":
            confidence = confidence[1:]
        if self.spoil == "nan":
            confidence[0, 0] = np.nan
        return self.predict(frame1, frame2), confidence


class Blackens:
    """Overwrites its input after predicting from it."""

    def predict(self, frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
        flow = np.stack([frame1[..., 0], frame2[..., 1]], axis=2).astype(np.float32)
        frame1[:] = frame2[:] = 0
        return flow

    def predict_batch(self, frames1: list[np.ndarray], frames2: list[np.ndarray]) -> list[np.ndarray]:
        return list(map(self.predict, frames1, frames2))


class ReusesItsBuffer:
    """Returns every flow in the same array, and so overwrites the flow that it returned before."""

    def __init__(self) -> None:
        self._flow = np.empty(0, np.float32)

    def predict(self, frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
        return self.predict_batch([frame1], [frame2])[0]

    def predict_batch(self, frames1: list[np.ndarray], frames2: list[np.ndarray]) -> np.ndarray:
        flows = [Sure().predict(*pair) for pair in zip(frames1, frames2, strict=True)]
        if self._flow.shape[1:] != flows[0].shape:
            self._flow = np.empty((8, *flows[0].shape), np.float32)
        self._flow[: len(flows)] = flows
        return self._flow[: len(flows)]


class Accelerated:
    """A model that claims to be on an accelerator. Its flow depends on every pixel of both frames; if PREDICTION_LOG
    names a file, it records the process and the number of pairs of each prediction.
    """

    def __init__(self, device: str = "cuda:0", pause: float = 0.0) -> None:
        self.device = device
        self._pause = pause

    def identity(self) -> dict[str, str]:
        return {"name": "accelerated", "device": self.device.partition(":")[0]}

    def predict(self, frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
        return self.predict_batch([frame1], [frame2])[0]

    def predict_batch(self, frames1: list[np.ndarray], frames2: list[np.ndarray]) -> list[np.ndarray]:
        time.sleep(self._pause)
        if log := os.environ.get("PREDICTION_LOG"):
            with open(log, "a") as file:
                file.write(f"{os.getpid()} {self.device} {len(frames1)}\n")
        u, v = ([frame.astype(np.int32) for frame in frames] for frames in (frames1, frames2))
        return [
            np.stack([a[..., 0] - b[..., 1], (a + b).sum(axis=2) // 9], axis=2).astype(np.float32) / 8
            for a, b in zip(u, v, strict=True)
        ]


class SilentError(Exception):
    """Has no message, because making it fails."""

    def __str__(self):
        return self.missing


class Trouble(Accelerated):
    """Fails after some predictions: returns a NaN ("nan") or channels first ("shape"), "raises" (or "raises silently"),
    "exits" (like a script whose argument parser fails), "stops as ..." (an exception that
    ends a process), "hangs", "crashes" or "dies" (like native code)."""

    def __init__(self, trouble="", after=0, device="cpu", pause=0.0):
        super().__init__(device, pause)
        self._trouble, self._left = trouble, after

    def predict(self, frame1, frame2):
        flow = super().predict(frame1, frame2)
        self._left -= 1
        if self._left >= 0:
            return flow
        match self._trouble:
            case "nan":
                flow[3, 5] = np.nan
            case "shape":
                flow = flow.transpose(2, 0, 1)
            case "raises":
                raise ValueError("no weights\nat all")
            case "raises silently":
                raise SilentError
            case "exits":
                raise SystemExit(2)
            case "stops as a generator":
                raise GeneratorExit("closed")
            case "stops as on Ctrl-C":
                raise KeyboardInterrupt("pressed")
            case "hangs":
                time.sleep(600)
            case "crashes":
                os.kill(os.getpid(), signal.SIGSEGV)
            case "dies":
                os._exit(17)
        return flow


class Faulty:
    """Returns a flow that depends on the frames, after a pause, and fails once during a run: "exit" ends its process,
    "hang" never returns, "lock" neither and holds the interpreter's lock, "stop" stops its process, and "memory" keeps
    using more. The failing process is recorded in the folder FAULTS, and the process and GPU of every prediction in the
    file `log`."""

    def __init__(self, pause=0.0, fault="", device="cpu", log=""):
        self._pause, self._fault, self._device, self._log = pause, fault, device, log
        self._asked = 0

    def identity(self):
        return {"name": "faulty", "pause": "", "fault": "", "device": "", "log": ""}

    def predict(self, frame1, frame2):
        self._asked += 1
        time.sleep(self._pause)
        if self._asked == 4 and self._fault:
            with suppress(FileExistsError), open(f"{os.environ['FAULTS']}/failed", "x") as failed:
                print(os.getpid(), file=failed, flush=True)
                self._fail()
        if self._log:
            with open(self._log, "a") as log:
                log.write(f"{os.getpid()} {os.environ.get('CUDA_VISIBLE_DEVICES')}\n")
        return np.stack([frame1[..., 0], frame2[..., 1]], axis=2).astype(np.float32) / 16

    def _fail(self):
        if self._fault == "exit":
            os._exit(17)
        if self._fault == "hang":
            time.sleep(600)
        if self._fault == "lock":
            re.match(r"(a+)+$", "a" * 60 + "b")
        if self._fault == "stop":
            os.kill(os.getpid(), signal.SIGSTOP)
        taken = []
        while True:
            taken.append(np.ones(2**25, np.uint8))
            time.sleep(0.02)
