"""The training loop: an interrupted and resumed run gives bit-identical weights to an undisturbed run; invalid input
raises an error."""

import json
import os
import random
import select
import shutil
import signal
import subprocess
import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

from torch import distributed  # noqa: E402

import robustflow as rf  # noqa: E402
from robustflow.core.errors import DataError, ModelError, RunError, UsageError  # noqa: E402
from robustflow.data.benchmarks.setting import setting_of  # noqa: E402
from robustflow.models.torch.network_model import TorchvisionRaft  # noqa: E402
from robustflow.run.plan import name_model  # noqa: E402
from robustflow.training import session  # noqa: E402
from robustflow.training.checkpoint import read_progress  # noqa: E402
from robustflow.training.processes import this_process  # noqa: E402
from robustflow.training.recipe import load_recipe  # noqa: E402
from robustflow.training.request import Checkpoints, Validation  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402
from robustflow.training.trained_network import load_network  # noqa: E402
from robustflow.training.validate import ValidationScores  # noqa: E402

from ..models.textures import textured_pair  # noqa: E402
from ..refusals import refusal  # noqa: E402
from .progress import (  # noqa: E402
    ONE_THREAD,
    StopAfter,
    assert_same_training,
    lines,
    train_in_two_processes,
    training_command,
    weights,
)

pytestmark = [pytest.mark.training, pytest.mark.torch]


def test_resumed_training_equals_an_uninterrupted_one_with_any_number_of_loaders(request_for):
    whole = request_for("whole", steps=4)
    run_training(whole)
    for stop, loaders in ((1, 0), (3, 1)):
        parted = request_for(f"parted{stop}", steps=4, checkpoints=Checkpoints(1000))
        run_training(parted, StopAfter(stop))
        assert len(lines(parted.output)) == stop
        run_training(replace(parted, resume=True, data=replace(parted.data, loaders=loaders)))
        assert_same_training(whole.output, parted.output)


@pytest.mark.slow
def test_training_killed_at_ten_moments_resumes_to_the_same_weights(request_for, tmp_path):
    def start(request) -> subprocess.Popen:
        return subprocess.Popen(training_command(request, tmp_path), env=ONE_THREAD, stderr=subprocess.DEVNULL)

    whole = request_for("whole", steps=12, checkpoints=Checkpoints(1))
    assert start(whole).wait() == 0
    killed = request_for("killed", steps=12, checkpoints=Checkpoints(1))
    moments, kills = random.Random(1), 0
    process = start(killed)
    while kills < 10:
        before = len(lines(killed.output)) if (killed.output / "metrics.jsonl").exists() else 0
        deadline = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline:
            path = killed.output / "metrics.jsonl"
            if path.exists() and len(path.read_text().splitlines()) > before:
                break
            time.sleep(0.02)
        time.sleep(moments.random() * 0.4)
        if process.poll() is not None:
            break
        process.send_signal(signal.SIGKILL)
        process.wait()
        kills += 1
        resumed = (killed.output / "last.pth").exists()
        if not resumed:
            for path in killed.output.glob("metrics.jsonl"):
                path.unlink()
        process = start(replace(killed, resume=resumed, data=replace(killed.data, loaders=kills % 2)))
    assert process.wait() == 0
    assert kills >= 5
    assert_same_training(whole.output, killed.output)


STARTS_AFTER_ITS_PARENT = """
import os, sys, time
if "forkserver" in " ".join(sys.orig_argv):
    from multiprocessing import spawn
    trainer, start = os.getppid(), spawn._main
    def late(*given):
        with open(os.path.join(os.path.dirname(__file__), "starting"), "w") as file:
            file.write(str(os.getpid()))
        while os.path.exists(f"/proc/{trainer}"):
            time.sleep(0.01)
        return start(*given)
    spawn._main = late
"""


@pytest.mark.slow
def test_a_killed_training_ends_the_loader_process_that_it_was_starting(request_for, tmp_path):
    os.mkfifo(tmp_path / "starting")
    starting = os.open(tmp_path / "starting", os.O_RDONLY | os.O_NONBLOCK)
    (tmp_path / "sitecustomize.py").write_text(STARTS_AFTER_ITS_PARENT)
    command = training_command(request_for(loaders=1), tmp_path)
    process = subprocess.Popen(command, env=ONE_THREAD | {"PYTHONPATH": str(tmp_path)}, stderr=subprocess.DEVNULL)
    try:
        assert select.select([starting], [], [], 120)[0]
        ended = os.pidfd_open(int(os.read(starting, 20)))
    finally:
        process.kill()
        process.wait()
        os.close(starting)
    try:
        assert select.select([ended], [], [], 60)[0]
    finally:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(ended, signal.SIGKILL)
        os.close(ended)


def test_the_file_is_a_checkpoint_that_run_reads_and_labels(request_for):
    request = request_for()
    path = run_training(request)
    model = rf.load_model("raft_small", checkpoint=str(path), device="cpu", iterations=2)
    state = weights(path)
    assert all(torch.equal(value, state[key.removeprefix("model.")]) for key, value in model.net.state_dict().items())
    training = name_model(model).training
    assert training.sets == ("flyingchairs",)
    assert setting_of(training, "kitti-fc") == "OOD"


def test_training_sets_of_the_start_weights_are_kept_or_unknown_if_undeclared(request_for):
    first = run_training(request_for("first"))
    second = run_training(request_for("second", start=str(first)))
    assert torch.load(second, weights_only=True)["robustflow_trained_on"] == "flyingchairs"
    bare = first.parent / "bare.pth"
    torch.save(weights(first), bare)
    third = run_training(request_for("third", start=str(bare)))
    assert "robustflow_trained_on" not in torch.load(third, weights_only=True)
    fourth = run_training(request_for("fourth", start=str(bare), start_trained_on="T"))
    assert torch.load(fourth, weights_only=True)["robustflow_trained_on"] == "flyingthings3d+flyingchairs"
    fifth = run_training(request_for("fifth", start=str(bare), start_trained_on="T", mix="small_shapes"))
    assert torch.load(fifth, weights_only=True)["robustflow_trained_on"] == "flyingthings3d+shapes:train"


def test_two_processes_stop_together_with_the_weights_of_one_process_to_rounding(request_for, tmp_path):
    """A signal reaches the processes at different times; a process that stops must not leave the other one waiting."""
    alone = request_for("alone", batch=1, accumulate=2, steps=12)
    run_training(alone, StopAfter(3))
    both = request_for("both", batch=2, steps=6)
    assert both.recipe.updates == alone.recipe.updates
    stop = "lambda updates=itertools.count(1): next(updates) == 3 and os.environ['RANK'] == '1'"
    train_in_two_processes(both, tmp_path, stop)
    assert len(lines(both.output)) == 3
    one, two = weights(alone.output / "last.pth"), weights(both.output / "last.pth")
    for key, value in one.items():
        if value.is_floating_point():
            assert torch.allclose(value, two[key], rtol=1e-3, atol=2e-6), key


def test_a_loss_that_is_not_finite_names_update_and_pairs_and_keeps_the_last_checkpoint(request_for):
    request = request_for(learning_rate=1e30, checkpoints=Checkpoints(1))
    with pytest.raises(ModelError) as caught:
        run_training(request)
    assert caught.value.culprit in ("loss", "gradient")
    assert "flyingchairs 0000" in str(caught.value)
    assert (request.output / "last.pth").exists()


def test_a_network_that_fails_in_training_is_named_with_its_crop(request_for, monkeypatch):
    def fail(*images):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(TorchvisionRaft, "predictions", fail)
    refusal(lambda: run_training(request_for()), ModelError, "raft_small")


def test_another_training_in_the_folder_is_not_overwritten_and_not_resumed(request_for):
    request = request_for()
    run_training(request, StopAfter(1))
    refusal(lambda: run_training(request), UsageError, request.output)
    other, elsewhere = request.recipe.changed(learning_rate=1e-5), request.output.parent / "elsewhere"
    for name, change in {"recipe": {"recipe": other}, "seed": {"seed": 1}, elsewhere: {"output": elsewhere}}.items():
        refusal(lambda change=change: run_training(replace(request, resume=True, **change)), RunError, name)


REFUSED = [
    ({"crop": (64, 64)}, UsageError, "--crop"),  # the network cannot see it
    ({"seed": -1}, UsageError, "--seed"),
    ({"seed": 2**63}, UsageError, "--seed"),  # PyTorch does not have it
    ({"sources": ["{empty}"]}, DataError, "flyingchairs split=train"),
    ({"start": "{empty}/nothing.pth"}, ModelError, "{empty}/nothing.pth"),
    ({"mix": "frames", "sources": ["folder={chairs}/FlyingChairs_release/data"]}, UsageError, "folder"),
    ({"mix": "kitti", "sources": ["{chairs}"]}, DataError, "kitti2015"),
    ({"mix": "kitti", "sources": ["kitti2015={chairs}"]}, DataError, "{chairs}"),
]


@pytest.mark.parametrize(("changes", "error", "culprit"), REFUSED)
def test_a_training_that_cannot_start_is_refused_in_one_line(request_for, chairs, tmp_path, changes, error, culprit):
    def filled(text):
        return text.format(chairs=chairs, empty=tmp_path) if isinstance(text, str) else text

    changes = {key: [*map(filled, one)] if key == "sources" else filled(one) for key, one in changes.items()}
    refusal(lambda: run_training(request_for(**changes)), error, filled(culprit))


def test_a_recipe_that_continues_another_needs_its_weights(request_for):
    things = load_recipe("raft_small", "things").changed(batch=2, crop=(128, 144), mix="chairs")
    refusal(lambda: run_training(replace(request_for(), recipe=things, start=None)), UsageError, "--init")


def test_a_missing_frame_is_named(request_for, chairs, tmp_path):
    copy = Path(shutil.copytree(chairs, tmp_path / "copy")) / "FlyingChairs_release"
    (copy / "data" / "00002_img2.ppm").unlink()
    refusal(
        lambda: run_training(request_for(sources=[f"flyingchairs={copy}"])), DataError, copy / "data/00002_img2.ppm"
    )


def test_a_pair_that_cannot_be_read_is_named_or_skipped(request_for, chairs, tmp_path):
    copy = Path(shutil.copytree(chairs, tmp_path / "copy"))
    (copy / "FlyingChairs_release" / "data" / "00003_img1.ppm").write_bytes(b"P6 not a picture")
    request = request_for(steps=4, sources=[copy])
    refusal(lambda: run_training(request), DataError, "flyingchairs 00003")
    with pytest.warns(UserWarning, match="00003"):
        run_training(request_for("skipped", steps=4, sources=[copy], skip_bad=True))


def test_validation_predicts_in_tiles_like_a_run():
    recipe = load_recipe("raft_small", "chairs").changed(crop=(128, 128), iterations=1)
    model, network = load_network(recipe, "random", "cpu", {"tile": "128x136"})
    run = rf.load_model("raft_small", checkpoint="random", iterations=1, tile="128x136", device="cpu")
    pair = textured_pair(130, 200)
    assert np.array_equal(model.predict(*pair), run.predict(*pair))
    assert network.net is model.model.net


def test_processes_wait_for_each_other_as_long_as_a_validation_may_take(monkeypatch):
    joined = {}
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setattr(distributed, "init_process_group", lambda backend, timeout: joined.update(timeout=timeout))
    monkeypatch.setattr(distributed, "destroy_process_group", lambda: None)
    with this_process("cpu"):
        assert joined["timeout"] > timedelta(hours=12)


def test_validation_has_the_numbers_of_a_run_and_the_best_weights_are_stored(request_for, chairs, tmp_path):
    data = chairs / "FlyingChairs_release"
    validation = Validation("flyingchairs", data, every=2, corruptions=["contrast"], limit=2)
    request = request_for(steps=3, validation=validation, iterations=1, checkpoints=Checkpoints(2, keep_every=1))
    run_training(request)
    entries = [entry for entry in lines(request.output) if "validation_epe" in entry]
    assert [entry["update"] for entry in entries] == [1, 2]  # after two updates, and at the end
    entry, weights_of_update = entries[0], request.output / "update-2.pth"
    model = rf.load_model("raft_small", checkpoint=str(weights_of_update), device="cpu", iterations=1)
    run = rf.evaluate(model, "flyingchairs", data, tmp_path / "run", corruptions=["contrast"], limit=2, progress=False)
    assert {"epe": run.epe_clean, "cre": run.cre, "rcre": run.rcre} == {
        name: entry[f"validation_{name}"] for name in ("epe", "cre", "rcre")
    }
    assert (request.output / "best.pth").exists()


@pytest.fixture
def scored(monkeypatch):
    """A list that receives the number of updates at each validation, which scores 1 / updates, or fails instead if the
    benchmark is "fails"; the data of a validation identify its pairs."""
    validated = []

    def validator(model, validation):
        def validate(updates):
            if validation.benchmark == "fails":
                raise DataError("the benchmark is gone")
            validated.append(updates)
            return ValidationScores({"epe": 1 / updates + (9 if validation.data else 0)}, str(validation.data))

        return validate

    monkeypatch.setattr(session, "validator", validator)
    return validated


def test_best_weights_are_compared_only_on_equal_pairs(request_for, scored):
    request = request_for(steps=4, validation=Validation("sintel", every=1))
    run_training(request, StopAfter(3))
    run_training(replace(request, resume=True, validation=Validation("sintel", "other pairs", every=1)))
    best = json.loads(torch.load(request.output / "best.pth", weights_only=True)["robustflow_training"])
    assert scored == [1, 2, 3, 4]
    assert (best["updates"], best["best"], best["best_on"]) == (4, 9.25, "other pairs")


def test_failed_validation_loses_no_update_and_is_repeated(request_for, scored):
    request = request_for(steps=4, validation=Validation("sintel", every=2), checkpoints=Checkpoints(1000))
    run_training(request)
    for name, fails, stop in (("failed", True, StopAfter(9)), ("stopped", False, StopAfter(2))):
        parted = replace(request, output=request.output.parent / name)
        with pytest.raises(DataError) if fails else nullcontext():
            run_training(replace(parted, validation=Validation("fails" if fails else "sintel", every=2)), stop)
        assert read_progress(parted.output / "last.pth")[1].updates == 2
        scored.clear()
        run_training(replace(parted, resume=True))
        assert scored == [2, 4]
        assert_same_training(request.output, parted.output)
        assert (parted.output / "best.pth").read_bytes() == (request.output / "best.pth").read_bytes()


def test_two_trainings_in_one_folder_are_refused(request_for):
    request = request_for(checkpoints=Checkpoints(1), steps=3)
    refused = []

    def start_another() -> bool:
        if (request.output / "last.pth").exists():
            refused.append(refusal(lambda: run_training(replace(request, resume=True)), RunError, request.output))
        return False

    run_training(request, start_another)
    assert len(refused) == 2
    run_training(replace(request, resume=True))  # the lock is released


def test_a_resumed_training_removes_the_checkpoint_that_a_killed_one_was_writing(request_for):
    request = request_for(steps=2)
    run_training(request, StopAfter(1))
    unfinished = request.output / ".partial-0a1b2c3d-last.pth"
    unfinished.write_bytes(b"half a checkpoint")
    run_training(replace(request, resume=True))
    assert not unfinished.exists()


def test_corrupted_frames_change_what_is_learned_and_the_identity(request_for):
    plain = request_for("plain", steps=2)
    corrupted = request_for("corrupted", steps=2, corruptions=["fog"], probability=1.0)
    run_training(plain)
    run_training(corrupted)
    assert lines(plain.output)[0]["loss"] != lines(corrupted.output)[0]["loss"]
    refusal(lambda: run_training(replace(corrupted, resume=True, data=plain.data)), RunError, "corruptions")


def test_own_mix_file_is_used_and_an_unreadable_one_refused(request_for, tmp_path):
    mix = tmp_path / "mine.toml"
    mix.write_text('parts = [{data = "flyingchairs", augmentation = "dense", log2_scale = [0, 0.2], flip = false}]')
    request = request_for(steps=2, mix=str(mix))
    run_training(request)
    mix.write_text(mix.read_text().replace("0.2", "0.3"))
    refusal(lambda: run_training(replace(request, resume=True)), RunError, "data")
    for text in ("parts = []", "parts = 3", "nonsense", 'parts = [{data = "sintel"}]', "a." * 9999):
        mix.write_text(text)
        refusal(lambda: run_training(request_for("other", mix=str(mix))), UsageError, mix)
