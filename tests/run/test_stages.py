"""The stages of a cell: the digest of its frames covers their bytes and sizes; several severities that are predicted
in one call have the same rows, and invalid results raise a clear error."""

import numpy as np
import pytest
from blake3 import blake3

import robustflow as rf
from robustflow.core.errors import ModelError
from robustflow.data.benchmarks import Benchmark
from robustflow.run.stages import PredictionRequest, PredictStage, frames_digest
from robustflow.testing import TexturePairs

from ..refusals import refusal
from .models_for_tests import Accelerated


class Batched(Accelerated):
    """Records the number of pairs in every call."""

    def __init__(self) -> None:
        super().__init__("cpu")
        self.calls: list[int] = []

    def predict_batch(self, frames1, frames2):
        self.calls.append(len(frames1))
        return super().predict_batch(frames1, frames2)


def run(model, folder, **options):
    benchmark = Benchmark("drawn", TexturePairs(1), ("0",), ("contrast", "impulse_noise"), (1, 2, 4))
    return rf.evaluate(model, benchmark, output=folder, **options)


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    return run(Batched(), tmp_path_factory.mktemp("single") / "run")


@pytest.mark.parametrize(("size", "calls"), [(1, [1] * 6), (2, [1, 1, 2, 2]), (3, [3, 3]), (9, [3, 3])])
def test_rows_do_not_depend_on_the_batch(single, tmp_path, size, calls):
    model = Batched()
    batched = run(model, tmp_path / "batched", batch_size=size)
    assert sorted(model.calls) == [1, 1, *calls]  # the clean pair, twice
    assert batched.rows.equals(single.rows)
    assert batched.manifest.identity_digest == single.manifest.identity_digest


@pytest.mark.parametrize(
    ("answer", "culprit"),
    [
        (lambda flows: flows[:1], "sample '0', contrast severity 1, 2, 4"),
        (lambda flows: [flows[0], flows[1][:9], flows[2]], "sample '0', contrast severity 2"),
        (lambda flows: 1 / 0, "sample '0', contrast severity 1, 2, 4"),
    ],
)
def test_wrong_answer_to_a_batch_is_refused(tmp_path, answer, culprit):
    class Wrong(Batched):
        def predict_batch(self, frames1, frames2):
            flows = super().predict_batch(frames1, frames2)
            return answer(flows) if len(flows) > 1 else flows

    refusal(lambda: run(Wrong(), tmp_path / "run", batch_size=3), ModelError, culprit)


@pytest.mark.parametrize(
    ("confidence", "draws", "batch", "calls"),
    [
        (None, 1, 1, 1),
        (None, 3, 2, 6),
        ("forward-backward", 1, 1, 2),
        ("forward-backward", 1, 2, 2),
        ("model", 1, 2, 2),
    ],
)
def test_time_limit_applies_to_each_call_of_the_model(confidence, draws, batch, calls):
    events: list[str] = []

    class Confident(Batched):
        def predict_batch(self, frames1, frames2):
            events.append("call")
            return super().predict_batch(frames1, frames2)

        def predict_with_confidence(self, frame1, frame2):
            return self.predict(frame1, frame2), np.zeros(frame1.shape[:2], np.float32)

    frames = np.random.default_rng(0).integers(0, 255, (2 * draws, 16, 24, 3)).astype(np.uint8)
    requests = [PredictionRequest((f"{number}", "fog", 3), tuple(frames), draws=draws) for number in range(batch)]
    stage = PredictStage(Confident(), confidence, lambda what: events.append(what or "end"))
    stage.predict(requests)
    assert events.count("call") == calls
    assert [event if event in ("call", "end") else "start" for event in events] == ["start", "call", "end"] * calls
    assert events[0].startswith("sample '0'")


PAIR = tuple(np.random.default_rng(0).integers(0, 256, (2, 5, 7, 3), np.uint8))
EMPTY = (np.empty((0, 7, 3), np.uint8),)
FORTRAN = tuple(map(np.asfortranarray, PAIR))
TURNED = tuple(frame.reshape(7, 5, 3) for frame in PAIR)


@pytest.mark.parametrize("frames", [PAIR, PAIR[::-1], PAIR[:1], FORTRAN, TURNED, EMPTY])
def test_digest_depends_on_shapes_bytes_and_order_only(frames):
    content = b"".join(str(frame.shape).encode() + frame.tobytes() for frame in frames)
    assert frames_digest(frames) == blake3(content).hexdigest(length=16)
