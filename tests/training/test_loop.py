"""The loop: an interrupted and resumed training equals the undisturbed one, to the bit; and what is refused."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

from robustflow.errors import DataError, ModelError, RunError, UsageError  # noqa: E402
from robustflow.training.checkpoint import TrainingProgress, read_progress, save_training  # noqa: E402
from robustflow.training.data.loader import workers_watched  # noqa: E402
from robustflow.training.request import Checkpoints, DataPlan, Validation  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


def weights(path: Path) -> dict[str, torch.Tensor]:
    return torch.load(path, weights_only=True)["model"]


def assert_equal(first: Path, second: Path) -> None:
    one, other = weights(first), weights(second)
    assert one.keys() == other.keys()
    assert all(torch.equal(one[key], other[key]) for key in one)


def lines(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def without_time(entries: list[dict]) -> list[dict]:
    return [{key: value for key, value in entry.items() if key != "seconds"} for entry in entries]


class StopAfter:
    """Requests the end after some updates."""

    def __init__(self, updates: int) -> None:
        self.left = updates

    def __call__(self) -> bool:
        self.left -= 1
        return self.left <= 0


def test_stopped_anywhere_and_resumed_with_other_loaders_it_is_the_undisturbed_training(request_for):
    whole = request_for("whole")
    run_training(whole)
    for stop, loaders in ((1, 0), (3, 1)):
        parted = request_for(f"parted{stop}", checkpoints=Checkpoints(1000))
        run_training(parted, StopAfter(stop))
        assert len(lines(parted.output)) == stop
        run_training(replace(parted, resume=True, data=replace(parted.data, loaders=loaders)))
        assert_equal(whole.output / "last.pth", parted.output / "last.pth")
        assert without_time(lines(parted.output)) == without_time(lines(whole.output))


SCRIPT = """
import pickle, sys
from robustflow.training.session import run_training
if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        run_training(pickle.load(file))
"""


@pytest.mark.slow
def test_killed_at_ten_moments_and_resumed(request_for, tmp_path):
    import pickle
    import random

    (tmp_path / "it.py").write_text(SCRIPT)

    def start(request) -> subprocess.Popen:
        with open(tmp_path / "request.pkl", "wb") as file:
            pickle.dump(request, file)
        command = [sys.executable, str(tmp_path / "it.py"), str(tmp_path / "request.pkl")]
        return subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, stderr=subprocess.DEVNULL)

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
    assert_equal(whole.output / "last.pth", killed.output / "last.pth")


def test_the_file_is_a_checkpoint_that_run_reads_and_labels(request_for):
    import robustflow as rf
    from robustflow.runner.named_model import name_model

    request = request_for()
    path = run_training(request)
    model = rf.load_model("raft_small", checkpoint=str(path), device="cpu", iterations=2)
    state = weights(path)
    assert all(torch.equal(value, state[key.removeprefix("model.")]) for key, value in model.net.state_dict().items())
    assert name_model(model).declared == "flyingchairs"
    from robustflow.benchmarks.setting import setting_of
    from robustflow.models.provenance import training_of

    named = name_model(model)
    assert setting_of(training_of(named.identity, named.declared), "kitti-fc") == "OOD"


def test_what_the_first_weights_have_seen_is_kept_and_is_unknown_where_nobody_says(request_for):
    first = run_training(request_for("first"))
    second = run_training(request_for("second", start=str(first)))
    assert torch.load(second, weights_only=True)["robustflow_trained_on"] == "flyingchairs"
    bare = first.parent / "bare.pth"
    torch.save(weights(first), bare)
    third = run_training(request_for("third", start=str(bare)))
    assert "robustflow_trained_on" not in torch.load(third, weights_only=True)
    fourth = run_training(request_for("fourth", start=str(bare), start_trained_on="T"))
    assert torch.load(fourth, weights_only=True)["robustflow_trained_on"] == "flyingthings3d+flyingchairs"


def test_one_process_and_two_make_the_same_weights_to_rounding(request_for, tmp_path):
    import pickle

    alone = request_for("alone", batch=1, accumulate=2, steps=6, device="cpu")
    run_training(alone)
    both = request_for("both", batch=2, steps=3, device="cpu")
    assert both.recipe.updates == alone.recipe.updates
    with open(tmp_path / "request.pkl", "wb") as file:
        pickle.dump(both, file)
    (tmp_path / "it.py").write_text(SCRIPT)
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--master-port", "29655"]
    command += [str(tmp_path / "it.py"), str(tmp_path / "request.pkl")]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    one, two = weights(alone.output / "last.pth"), weights(both.output / "last.pth")
    start = request_for("start", steps=1)
    for key, value in one.items():
        if value.is_floating_point():
            assert torch.allclose(value, two[key], rtol=1e-3, atol=2e-6), key
    assert start.recipe.method == "raft_small"


def test_one_of_two_processes_is_told_to_stop_and_both_do(request_for, tmp_path):
    """A signal reaches the processes at different moments; the one that stops must not leave the other waiting."""
    import pickle

    request = request_for("both", steps=200, batch=2, device="cpu")
    with open(tmp_path / "request.pkl", "wb") as file:
        pickle.dump(request, file)
    script = SCRIPT.replace("pickle.load(file))", "pickle.load(file), lambda: os.environ['RANK'] == '1')")
    (tmp_path / "it.py").write_text("import os\n" + script)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += [str(tmp_path / "it.py"), str(tmp_path / "request.pkl")]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert len(lines(request.output)) == 1
    assert (request.output / "last.pth").exists()


def test_a_reading_process_that_is_killed_is_an_error_in_a_sentence(request_for):
    def kill() -> bool:
        for child in multiprocessing.active_children():
            os.kill(child.pid, signal.SIGKILL)
        return False

    with pytest.raises(RunError, match="a process that reads training pairs was killed"):
        run_training(request_for(steps=200, checkpoints=Checkpoints(1), loaders=1), kill)


@pytest.mark.parametrize("later", [None, RuntimeError("unexpected pos 64 vs 0"), DataError("no room")])
def test_a_killed_reader_is_recognised_behind_a_later_error(later):
    def write_a_checkpoint():
        try:
            raise RuntimeError("DataLoader worker (pid 1) is killed by signal: Killed.")
        finally:
            if later is not None:
                raise later

    with pytest.raises(RunError, match="a process that reads training pairs was killed"), workers_watched():
        write_a_checkpoint()


def test_other_errors_of_a_training_stay_what_they_are():
    for error in (RuntimeError("mat1 and mat2 shapes cannot be multiplied"), DataError("no such file")):
        with pytest.raises(type(error), match=str(error)), workers_watched():
            raise error


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_all_processes_ends_the_training_with_a_checkpoint(sent, chairs, tmp_path):
    command = [sys.executable, "-m", "robustflow", "train", "raft_small", "--recipe", "chairs", "--data", str(chairs)]
    command += ["--batch-size", "1", "--crop", "128x144", "--iterations", "1", "--accumulate", "3", "--loaders", "2"]
    command += ["--output", str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    log = tmp_path / "out" / "metrics.jsonl"
    while process.poll() is None and not (log.exists() and log.stat().st_size):
        time.sleep(0.2)
    os.killpg(process.pid, sent)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert "Give the same command with --resume to continue" in said
    assert "Traceback" not in said
    assert (tmp_path / "out" / "last.pth").exists()


def test_a_loss_that_is_not_finite_names_update_and_pairs_and_keeps_the_last_checkpoint(request_for):
    request = request_for(learning_rate=1e30, checkpoints=Checkpoints(1))
    with pytest.raises(ModelError, match=r"the (loss|gradient) is (nan|inf) at update \d, on flyingchairs 0000\d, fly"):
        run_training(request)
    assert (request.output / "last.pth").exists()


def test_another_training_in_the_folder_is_not_overwritten_and_not_resumed(request_for):
    request = request_for()
    run_training(request, StopAfter(1))
    with pytest.raises(UsageError, match="holds a training; continue it with --resume"):
        run_training(request)
    with pytest.raises(RunError, match="differs in: recipe;"):
        run_training(replace(request, resume=True, recipe=request.recipe.changed(learning_rate=1e-5)))
    with pytest.raises(RunError, match="differs in: seed;"):
        run_training(replace(request, resume=True, seed=1))
    with pytest.raises(RunError, match="no training to resume"):
        run_training(replace(request, resume=True, output=request.output.parent / "elsewhere"))


def test_a_damaged_checkpoint_and_one_of_weights_alone_are_one_line(request_for):
    request = request_for()
    path = run_training(request, StopAfter(1))
    state = weights(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(ModelError, match="truncated or damaged"):
        run_training(replace(request, resume=True))
    torch.save({"model": state}, path)
    with pytest.raises(RunError, match="start from them with --init"):
        run_training(replace(request, resume=True))


def _as_stored(content: object) -> str:
    """A checkpoint's content as text."""
    if isinstance(content, torch.Tensor):
        return f"{content.dtype}{tuple(content.shape)}{content.flatten().tolist()}"
    if isinstance(content, dict):
        return str({key: _as_stored(value) for key, value in content.items()})
    return str([_as_stored(part) for part in content]) if isinstance(content, list | tuple) else repr(content)


@pytest.fixture
def small(tmp_path) -> Path:
    """A checkpoint of a small network."""
    torch.manual_seed(0)
    net = torch.nn.Linear(5, 3)
    optimizer = torch.optim.AdamW(net.parameters())
    net(torch.ones(5)).sum().backward()
    optimizer.step()
    about = TrainingProgress(1, {"seed": 0}, 2.5)
    path = tmp_path / "last.pth"
    save_training(path, net.state_dict(), about, "C+T", optimizer, torch.amp.GradScaler("cpu", enabled=False))
    return path


def test_a_flipped_bit_of_the_last_checkpoint_is_noticed_or_changes_nothing(small):
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
    with pytest.raises(ModelError, match="does not match its digest"):
        read_progress(small)


def test_a_small_checkpoint_that_would_take_much_memory_is_refused_before_it_does(small):
    content = torch.load(small, weights_only=True)
    content["optimizer"]["state"][0]["exp_avg"] = torch.zeros(1).expand(10**9)
    torch.save(content, small)
    with pytest.raises(ModelError, match="its tensors are larger than the file"):
        read_progress(small)
    with zipfile.ZipFile(small.with_name("bomb.pth"), "w", zipfile.ZIP_DEFLATED) as bomb:
        with zipfile.ZipFile(small) as archive:
            for name in archive.namelist():
                bomb.writestr(name, archive.read(name))
        bomb.writestr("archive/data/99", bytes(10**8))
    with pytest.raises(ModelError, match="would unpack to"):
        read_progress(small.with_name("bomb.pth"))


@pytest.mark.parametrize("name", ["validation", "metrics.jsonl", "last.pth"])
def test_a_link_in_the_folder_of_a_training_is_refused(request_for, tmp_path, name):
    request = request_for()
    request.output.mkdir(parents=True)
    (request.output / name).symlink_to(tmp_path / "elsewhere")
    for resume in (False, True):
        with pytest.raises(RunError, match=f"{name} is a link"):
            run_training(replace(request, resume=resume))


def test_a_pair_that_cannot_be_read_is_named_or_skipped(request_for, chairs, tmp_path):
    import shutil

    copy = Path(shutil.copytree(chairs, tmp_path / "copy"))
    (copy / "FlyingChairs_release" / "data" / "00003_img1.ppm").write_bytes(b"P6 not a picture")
    request = request_for(steps=4, sources=[copy])
    with pytest.raises(DataError, match=r"training pair '00003' of flyingchairs: .*00003_img1\.ppm.*--skip-bad"):
        run_training(request)
    with pytest.warns(UserWarning, match="training pair '00003' of flyingchairs is skipped"):
        run_training(request_for("skipped", steps=4, sources=[copy], skip_bad=True))


def test_missing_data_and_a_missing_start_are_one_line(request_for, tmp_path):
    with pytest.raises(DataError, match=r"flyingchairs split=train was not found .*flyingchairs=FOLDER"):
        run_training(request_for(sources=[tmp_path]))
    with pytest.raises(ModelError, match=r"no file .*nothing\.pth"):
        run_training(request_for(start=str(tmp_path / "nothing.pth")))
    from robustflow.training.recipe import load_recipe

    things = load_recipe("raft_small", "things").changed(batch=2, crop=(128, 144))
    with pytest.raises(UsageError, match="starts from the weights of its stage 'chairs'"):
        run_training(replace(request_for(), recipe=things.changed(mix="chairs"), start=None))


def test_validation_is_a_run_of_its_own_and_keeps_the_best(request_for):
    from robustflow.runs.run import Run

    request = request_for(steps=3, validation=Validation("demo", every=2, corruptions=["contrast"]), iterations=1)
    run_training(request)
    entries = [entry for entry in lines(request.output) if "validation_epe" in entry]
    assert [entry["update"] for entry in entries] == [1, 2]  # after two updates, and at the end
    for entry in entries:
        run = Run(request.output / "validation" / f"update-{entry['update'] + 1}")
        assert run.epe_clean == entry["validation_epe"]
        assert run.cre == entry["validation_cre"]
    assert (request.output / "best.pth").exists()


def test_corrupted_frames_change_what_is_learned_and_the_identity(request_for):
    plain = request_for("plain", steps=2)
    corrupted = request_for("corrupted", steps=2, corruptions=["fog"], probability=1.0)
    run_training(plain)
    run_training(corrupted)
    assert lines(plain.output)[0]["loss"] != lines(corrupted.output)[0]["loss"]
    with pytest.raises(RunError, match="differs in: corruptions"):
        run_training(replace(corrupted, resume=True, data=plain.data))


def test_a_full_disk_at_a_checkpoint_keeps_the_one_before(request_for, monkeypatch):
    request = request_for(steps=4, checkpoints=Checkpoints(2))
    run_training(request, StopAfter(2))
    before = (request.output / "last.pth").read_bytes()

    def full(content, file):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(DataError, match=r"cannot write .*last\.pth: No space left on device"):
        run_training(replace(request, resume=True))
    assert (request.output / "last.pth").read_bytes() == before
    assert not list(request.output.glob(".partial-*"))


@pytest.mark.slow
def test_a_disk_that_is_full_indeed(request_for, tmp_path):
    """A file system in memory with room for only one checkpoint."""
    request = request_for(steps=4, checkpoints=Checkpoints(2))
    request.output.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=18m", "tmpfs", str(request.output)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no right to mount a file system here")
    try:
        with pytest.raises(DataError, match=r"cannot write .*last\.pth.*No space left on device"):
            run_training(request)
        kept = torch.load(request.output / "last.pth", weights_only=True)
        assert json.loads(kept["robustflow_training"])["updates"] == 2
        assert not list(request.output.glob(".partial-*"))
    finally:
        subprocess.run(["umount", "-l", str(request.output)], check=True)


def test_a_checkpoint_of_another_network_is_one_line(request_for, tmp_path):
    torch.save({"model": {"fnet.conv1.weight": torch.zeros(3, 3)}}, tmp_path / "other.pth")
    with pytest.raises(ModelError, match=r"other\.pth") as caught:
        run_training(request_for(start=str(tmp_path / "other.pth")))
    assert "\n" not in str(caught.value)
    (tmp_path / "page.pth").write_text("<html>not found</html>")
    with pytest.raises(ModelError, match=r"page\.pth") as caught:
        run_training(request_for(start=str(tmp_path / "page.pth")))
    assert "\n" not in str(caught.value)


def test_a_folder_of_another_data_set_names_what_was_expected(request_for, chairs, tmp_path):
    (tmp_path / "mixed" / "data").mkdir(parents=True)
    for path in (chairs / "FlyingChairs_release" / "data").iterdir():
        if path.name != "00002_img2.ppm":
            (tmp_path / "mixed" / "data" / path.name).symlink_to(path)
    (tmp_path / "mixed" / "training" / "image_2").mkdir(parents=True)
    with pytest.raises(DataError, match=r"00002_img2\.ppm: missing, though .*00002_.* needs it"):
        run_training(request_for(sources=[f"flyingchairs={tmp_path / 'mixed'}"]))
    kitti = request_for(mix="kitti")
    with pytest.raises(DataError, match=r"kitti2015 was not found \(.*; put it into a folder kitti2015 or kitti there"):
        run_training(replace(kitti, data=DataPlan([chairs])))
    with pytest.raises(DataError, match=r"not laid out like KITTI 2015; expected .*image_2"):
        run_training(replace(kitti, data=DataPlan([f"kitti2015={chairs}"])))


OWN_NETWORK = """
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(6, 8, 3, padding=1)
        self.norm = nn.BatchNorm2d(8)
        self.last = nn.Conv2d(8, 2, 3, padding=1)

    def forward(self, image1, image2):
        import torch

        features = self.norm(self.first(torch.cat([image1, image2], dim=1)))
        flow = self.last(features)
        return [flow / 2, flow]
"""


def test_a_network_of_ones_own(request_for, tmp_path, monkeypatch):
    import robustflow as rf

    (tmp_path / "own_net_for_test.py").write_text(OWN_NETWORK)
    monkeypatch.syspath_prepend(tmp_path)
    options = (("scaling", "-1-1"), ("order", "rgb"), ("layout", "pair"))
    request = request_for(options=options, frozen_norms="none")
    own = replace(request, recipe=request.recipe.changed(method="own_net_for_test:Net"))
    path = run_training(own)
    state = weights(path)
    assert state["norm.num_batches_tracked"] == own.recipe.updates  # in training mode
    assert len(lines(own.output)) == own.recipe.updates
    model = rf.load_model("own_net_for_test:Net", checkpoint=str(path), device="cpu", **dict(options))
    assert torch.equal(model.net.module.last.weight, state["last.weight"])


@pytest.mark.parametrize("kind", ["raft_small", "own_net_for_seed:Net"])
def test_the_seed_is_that_of_the_first_weights_too(request_for, tmp_path, monkeypatch, kind):
    from robustflow.training.networks import load_network

    (tmp_path / "own_net_for_seed.py").write_text(OWN_NETWORK)
    monkeypatch.syspath_prepend(tmp_path)
    recipe = request_for().recipe.changed(method=kind)
    options = {"scaling": "-1-1", "order": "rgb", "layout": "pair"} if ":" in kind else {}
    first, again, other = (load_network(recipe, "random", "cpu", options, seed)[1].weights() for seed in (3, 3, 4))
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert any(not torch.equal(first[key], other[key]) for key in first)
    if ":" not in kind:
        import robustflow as rf

        plain = rf.load_model(kind, checkpoint="random", device="cpu").net.model.state_dict()
        assert all(torch.equal(plain[key], value) for key, value in load_network(recipe, "random")[1].weights().items())


OWN_LOSS = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.last = nn.Conv2d(6, 2, 3, padding=1)

    def forward(self, image1, image2):
        return self.last(torch.cat([image1, image2], dim=1))

    def loss(self, batch):
        assert set(batch) == {"image1", "image2", "flow", "valid"}
        assert batch["image1"].min() >= -1 and batch["image1"].max() <= 1
        flow = self(batch["image1"], batch["image2"])
        error = (flow - batch["flow"]).square().sum(1)[batch["valid"] > 0].mean()
        return RETURNED
"""


def test_a_network_that_says_its_loss_itself(request_for, tmp_path, monkeypatch):
    (tmp_path / "own_loss_for_test.py").write_text(OWN_LOSS.replace("RETURNED", 'error, {"squared": error}'))
    (tmp_path / "bad_loss_for_test.py").write_text(OWN_LOSS.replace("RETURNED", "[error]"))
    monkeypatch.syspath_prepend(tmp_path)
    options = (("scaling", "-1-1"), ("order", "rgb"), ("layout", "pair"))
    request = request_for(options=options, steps=2)
    own = replace(request, recipe=request.recipe.changed(method="own_loss_for_test:Net"))
    run_training(own)
    entries = lines(own.output)
    assert all(entry["loss"] == pytest.approx(entry["squared"]) for entry in entries)
    from robustflow.training.networks import load_network

    _, first = load_network(own.recipe, "random", "cpu", dict(options))
    assert not torch.equal(first.weights()["last.weight"], weights(own.output / "last.pth")["last.weight"])
    bad = replace(own, recipe=own.recipe.changed(method="bad_loss_for_test:Net"), output=tmp_path / "bad")
    with pytest.raises(UsageError, match=r"method loss\(batch\) returned list; return one number"):
        run_training(bad)
    odd = replace(own, recipe=own.recipe.changed(crop=(124, 140)), output=tmp_path / "odd")
    with pytest.raises(UsageError, match=r"would be padded to 128x144; give --crop 128x144"):
        run_training(odd)


def test_a_mix_of_ones_own_and_one_that_cannot_be_read(request_for, tmp_path):
    mix = tmp_path / "mine.toml"
    mix.write_text('parts = [{data = "flyingchairs", augmentation = "dense", log2_scale = [0, 0.2], flip = false}]')
    request = request_for(steps=2, mix=str(mix))
    run_training(request)
    mix.write_text(mix.read_text().replace("0.2", "0.3"))
    with pytest.raises(RunError, match="differs in: data"):
        run_training(replace(request, resume=True))
    for text in ("parts = []", "parts = 3", "nonsense", 'parts = [{data = "sintel"}]'):
        mix.write_text(text)
        with pytest.raises(UsageError, match=r"mine\.toml: (no mix of data can be read|a mix of data without)"):
            run_training(request_for("other", mix=str(mix)))
