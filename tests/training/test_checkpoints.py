"""Training checkpoints: damaged, forged or unrelated files are rejected, and full disks are reported."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

from robustflow.core.errors import DataError, ModelError, RunError  # noqa: E402
from robustflow.training.checkpoint import TrainingProgress, read_progress, save_training  # noqa: E402
from robustflow.training.loop import METRICS_FILE, MetricsLog  # noqa: E402
from robustflow.training.request import Checkpoints  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402

from ..refusals import refusal  # noqa: E402
from .progress import StopAfter, weights  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


def test_damaged_checkpoint_or_one_of_weights_only_is_refused_in_one_line(request_for):
    request = request_for()
    path = run_training(request, StopAfter(1))
    state = weights(path)
    whole = path.read_bytes()
    for damaged in (whole[:5000], whole[:-9], b"", b"<html>"):
        path.write_bytes(damaged)
        error = refusal(lambda: run_training(replace(request, resume=True)), ModelError, path)
        assert "download" not in str(error).rpartition(";")[2], "it was made on this machine"
    torch.save({"model": state}, path)
    refusal(lambda: run_training(replace(request, resume=True)), RunError, path)


def _as_stored(content: object) -> str:
    if isinstance(content, torch.Tensor):
        return f"{content.dtype}{tuple(content.shape)}{content.flatten().tolist()}"
    if isinstance(content, dict):
        return str({key: _as_stored(value) for key, value in content.items()})
    return str([_as_stored(part) for part in content]) if isinstance(content, list | tuple) else repr(content)


@pytest.fixture
def small(tmp_path) -> Path:
    torch.manual_seed(0)
    net = torch.nn.Linear(5, 3)
    optimizer = torch.optim.AdamW(net.parameters())
    net(torch.ones(5)).sum().backward()
    optimizer.step()
    about = TrainingProgress(1, {"seed": 0}, 2.5)
    path = tmp_path / "last.pth"
    save_training(path, net.state_dict(), about, "C+T", optimizer, torch.amp.GradScaler("cpu", enabled=False))
    return path


def test_a_flipped_bit_of_the_last_checkpoint_is_detected_or_changes_nothing(small):
    whole, rng = small.read_bytes(), np.random.default_rng(0)
    expected = [_as_stored(part) if isinstance(part, dict) else part for part in read_progress(small)]
    refused = 0
    for place, bit in zip(rng.integers(0, len(whole), 200), rng.integers(0, 8, 200), strict=True):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << bit
        small.write_bytes(flipped)
        try:
            read = [_as_stored(part) if isinstance(part, dict) else part for part in read_progress(small)]
            assert read == expected
        except (ModelError, RunError):
            refused += 1
    assert refused > 100


def test_a_checkpoint_whose_values_were_changed_with_a_valid_archive_is_refused(small):
    content = torch.load(small, weights_only=True)
    content["model"]["bias"][0] += 1
    torch.save(content, small)
    refusal(lambda: read_progress(small), ModelError, small)


def test_a_small_checkpoint_that_would_take_much_memory_is_refused_before_it_does(small):
    content = torch.load(small, weights_only=True)
    content["optimizer"]["state"][0]["exp_avg"] = torch.zeros(1).expand(10**9)
    torch.save(content, small)
    refusal(lambda: read_progress(small), ModelError, small)


def test_the_checkpoint_of_a_network_that_holds_a_module_under_two_names_resumes(tmp_path):
    layer = torch.nn.Linear(200, 200).requires_grad_(False)
    net = torch.nn.ModuleDict({"encoder": layer, "backbone": layer, "head": torch.nn.Linear(200, 2)})
    optimizer, path = torch.optim.AdamW(net["head"].parameters()), tmp_path / "last.pth"
    scaler = torch.amp.GradScaler("cpu", enabled=False)
    save_training(path, net.state_dict(), TrainingProgress(7, {}), None, optimizer, scaler)
    content, progress = read_progress(path)
    assert progress.updates == 7
    assert torch.equal(content["model"]["backbone.weight"], layer.weight)


@pytest.mark.parametrize("name", ["metrics.jsonl", "last.pth"])
def test_a_link_in_the_folder_of_a_training_is_refused(request_for, tmp_path, name):
    request = request_for()
    request.output.mkdir(parents=True)
    (request.output / name).symlink_to(tmp_path / "elsewhere")
    for each in (request, replace(request, resume=True)):
        refusal(partial(run_training, each), RunError, request.output / name)


def test_a_damaged_log_is_cut_to_its_readable_lines(tmp_path):
    (tmp_path / METRICS_FILE).write_bytes(b'{"update": 0}\n\xff\xfe\n{"update": 1}\n')

    with MetricsLog(tmp_path, 1) as log:
        log.write(1, {"loss": 2.0})

    assert (tmp_path / METRICS_FILE).read_text() == '{"update": 0}\n{"update": 1, "loss": 2.0}\n'


def test_a_full_disk_at_a_checkpoint_keeps_the_one_before(request_for, monkeypatch):
    request = request_for(checkpoints=Checkpoints(1))
    run_training(request, StopAfter(1))
    before = (request.output / "last.pth").read_bytes()

    def full(content, file):
        """PyTorch fails twice: on a write, and again when it closes the incomplete archive."""
        file.write(b"half")
        try:
            raise OSError(28, "No space left on device")
        finally:
            raise RuntimeError("unexpected pos 64 vs 0")

    monkeypatch.setattr(torch, "save", full)
    refusal(lambda: run_training(replace(request, resume=True)), DataError, request.output / "last.pth")
    assert (request.output / "last.pth").read_bytes() == before
    assert not list(request.output.glob(".partial-*"))


@pytest.mark.parametrize("content", [{"model": {"fnet.conv1.weight": torch.zeros(3, 3)}}, "<html>not found</html>"])
def test_start_weights_of_a_different_network_or_missing_ones_are_refused_in_one_line(request_for, tmp_path, content):
    path = tmp_path / "other.pth"
    path.write_text(content) if isinstance(content, str) else torch.save(content, path)
    refusal(lambda: run_training(request_for(start=str(path))), ModelError, path)
