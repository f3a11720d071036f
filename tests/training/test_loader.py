"""Batches are the same with any number of loaders; whatever happens in a loader, training ends within seconds, with one
line and no process left."""

import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

from robustflow.core.errors import DataError, RunError, UsageError  # noqa: E402
from robustflow.training.data.loader import Share, batches  # noqa: E402
from robustflow.training.data.parts import Order, open_part  # noqa: E402
from robustflow.training.data.training_pairs import TrainingPairs  # noqa: E402
from robustflow.training.recipe import mix_parts  # noqa: E402
from robustflow.training.request import Checkpoints  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402

from ..refusals import refusal  # noqa: E402
from ..run.processes import descendants, running, wait_until  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


@dataclass(frozen=True)
class Raises:
    """A user's corruption that fails."""

    error: BaseException

    def __call__(self, frames, key):
        raise self.error


@pytest.fixture
def pairs(chairs) -> TrainingPairs:
    parts = [open_part(part, [chairs], True) for part in mix_parts("chairs")]
    return TrainingPairs(parts, Order(8, 2, 0), (128, 144), 0)


def test_batches_are_the_same_with_any_number_of_loaders(pairs):
    alone = list(batches(pairs, Share(2), range(3, 14), 0))
    assert len(alone) == 11
    for loaders in (1, 2, 20):
        together = list(batches(pairs, Share(2), range(3, 14), loaders))
        assert [batch.names for batch in together] == [batch.names for batch in alone]
        for name in ("image1", "image2", "flow", "valid"):
            assert all(torch.equal(getattr(a, name), getattr(b, name)) for a, b in zip(alone, together, strict=True))
    assert len(alone) == 11
    assert multiprocessing.active_children() == []


PAIR = "the first pair"
ERRORS = [
    (OSError(5, "Input/output error"), DataError, PAIR),
    (EOFError(), DataError, PAIR),
    (ValueError("two\nlines"), DataError, PAIR),
    (SystemExit(0), DataError, PAIR),
    (MemoryError(), RunError, PAIR),
    (UsageError("haze", "needs depth"), UsageError, "haze"),
    (KeyboardInterrupt(), DataError, PAIR),
]


@pytest.mark.parametrize(("error", "kind", "culprit"), ERRORS, ids=lambda value: type(value).__name__)
def test_error_in_a_loader_has_the_class_and_culprit_of_this_process(pairs, error, kind, culprit):
    failing = replace(pairs, corruption=Raises(error))
    culprit = pairs[0].name if culprit is PAIR else culprit
    for loaders in (1,) if isinstance(error, KeyboardInterrupt) else (0, 1):  # in this process, it is Ctrl-C
        held = refusal(lambda loaders=loaders: next(batches(failing, Share(2), range(4), loaders)), kind, culprit)
        assert multiprocessing.active_children() == [], held.__traceback__


def test_ctrl_c_in_this_process_is_not_an_error_of_a_pair(pairs):
    with pytest.raises(KeyboardInterrupt):
        replace(pairs, corruption=Raises(KeyboardInterrupt()), skip_bad=True)[0]


def test_a_loader_that_is_killed_is_named(pairs):
    with closing(batches(pairs, Share(2), range(50), 2)) as reading:
        next(reading)
        for child in multiprocessing.active_children():
            os.kill(child.pid, signal.SIGKILL)
        refusal(lambda: list(reading), RunError, "--loaders")
    assert multiprocessing.active_children() == []


def test_a_loader_killed_in_training_is_named(request_for):
    def kill() -> bool:
        for child in multiprocessing.active_children():
            os.kill(child.pid, signal.SIGKILL)
        return False

    request = request_for(steps=200, checkpoints=Checkpoints(1), loaders=1)
    refusal(lambda: run_training(request, kill), RunError, "--loaders")


def test_an_unexpected_error_leaves_no_loader_for_which_the_process_would_wait_at_its_end(request_for):
    def stop() -> bool:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:  # its traceback keeps the variables of the loop alive
        run_training(request_for(loaders=1), stop)
    assert multiprocessing.active_children() == [], caught


def _start(chairs: Path, output: Path, *options: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "robustflow", "train", "raft_small", "--recipe", "chairs", "--data", str(chairs)]
    command += ["--batch-size", "1", "--crop", "128x144", "--output", str(output), *options]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)


@pytest.mark.parametrize("name", ["img1.ppm", "flow.flo"])
def test_a_truncated_file_ends_the_training_in_one_line(chairs, tmp_path, name):
    copy = Path(shutil.copytree(chairs, tmp_path / "copy"))
    for path in copy.rglob(f"*_{name}"):
        path.write_bytes(path.read_bytes()[:300])
    training = _start(copy, tmp_path / "out", "--loaders", "1", "--steps", "9")
    _, errors = training.communicate(timeout=120)
    assert training.returncode == 1
    assert errors.splitlines()[-1].startswith("robustflow: flyingchairs 0000"), errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("sent", "early"), [(signal.SIGINT, False), pytest.param(signal.SIGTERM, True, marks=pytest.mark.slow)]
)
def test_a_signal_to_all_processes_ends_the_training_with_a_checkpoint(sent, early, chairs, tmp_path):
    """An early signal reaches a loader that has not begun to ignore it."""
    training = _start(chairs, tmp_path / "out", "--loaders", "1", "--accumulate", "3", "--iterations", "1")
    log = tmp_path / "out" / "metrics.jsonl"
    wait_until(lambda: _has_loaders(training) if early else log.exists() and log.stat().st_size, training)
    os.killpg(training.pid, sent)
    _, errors = training.communicate(timeout=120)
    assert training.returncode == 130, errors
    assert "--resume" in errors
    assert "Traceback" not in errors
    assert (tmp_path / "out" / "last.pth").exists()


def _has_loaders(training: subprocess.Popen) -> bool:
    return "spawn_main" in str(descendants(training.pid)) or "forkserver" in str(descendants(training.pid))


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_a_second_signal_ends_the_training_at_once(sent, chairs, tmp_path):
    training = _start(chairs, tmp_path / "out", "--loaders", "2", "--accumulate", "8", "--iterations", "99")
    wait_until(lambda: len(descendants(training.pid)) > 2, training)  # loaders, and what forks them
    started = descendants(training.pid)
    training.send_signal(sent)
    assert "stopping" in training.stderr.readline()
    training.send_signal(sent)
    before = time.monotonic()
    assert training.wait(30) == -sent
    assert time.monotonic() - before < 5
    wait_until(lambda: not [line for line in running("forkserver") if int(line.split()[0]) in started], within_s=20)
