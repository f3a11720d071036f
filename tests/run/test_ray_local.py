"""The Ray engine on one machine, from the command line and in this process."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import AssetError, ModelError, RunError, UsageError
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelRef
from robustflow.run.engines.ray_cluster import connected
from robustflow.run.engines.ray_watch import processes_with_files_in
from robustflow.testing import TexturePairs, ZeroFlow

from ..refusals import refusal
from .conftest import FAST
from .processes import (
    check_stopped_by_ctrl_c,
    descendants,
    is_running,
    rows_so_far,
    start_run,
    still_running,
    wait_until,
)

pytestmark = pytest.mark.ray

SETTING = {"corruptions": FAST, "severities": [1, 4]}
DIS = ModelRef.parse("dis", {"preset": "ultrafast"})


@pytest.fixture(autouse=True)
def _folder(tmp_path_factory, monkeypatch):
    """Keep Ray's files for one test in a separate folder, and check that no Ray process is left running."""
    pytest.importorskip("ray", reason="needs the ray extra")
    folder = Path(tmp_path_factory.mktemp("r"))
    short = Path("/tmp") / f"rf-{os.getpid()}-{folder.name}"  # short, for Ray's sockets
    short.mkdir()
    monkeypatch.setenv("TMPDIR", str(short))
    monkeypatch.setattr("tempfile.tempdir", None)
    yield
    assert not still_running(str(short))
    assert not [number for path in short.glob("rf-*") for number in processes_with_files_in(str(path))]
    subprocess.run(["rm", "-rf", str(short)], check=True)


def _evaluate(folder, model, **options):
    return rf.evaluate(model, output=folder / "run", engine="ray", **SETTING, **options)


def test_ray_gives_the_rows_of_one_process_and_leaves_nothing_behind(tmp_path):
    """The record of where each row was computed is kept when the run is resumed with a different engine."""
    before = signal.getsignal(signal.SIGTERM)
    benchmark = Benchmark("drawn", TexturePairs(1, (48, 64)), ("0",), FAST, (1, 2, 4))
    attacked = SETTING | {"attacks": ["square:queries=3"]}
    whole = rf.evaluate(DIS, benchmark, output=tmp_path / "serial", **attacked)
    result = rf.evaluate(DIS, benchmark, output=tmp_path / "ray", engine="ray", workers=2, **attacked)
    assert result.rows.equals(whole.rows)
    assert result.attack_rows.equals(whole.attack_rows)
    assert result.attack_rows.filter(corruption="square:queries=3").height == len(SETTING["severities"])
    assert (result.path / "summary.json").read_bytes() == (whole.path / "summary.json").read_bytes()
    assert result.manifest.places == {f"{socket.gethostname()}, CPU": 1 + len(FAST) + len(result.attacks)}
    assert signal.getsignal(signal.SIGTERM) is before
    assert "ray" in sys.modules
    assert not sys.modules["ray"].is_initialized()
    assert not list(Path(os.environ["TMPDIR"]).iterdir())
    places = result.manifest.places
    more = rf.evaluate(DIS, benchmark, output=tmp_path / "ray", **{**SETTING, "severities": [2]})
    assert rf.load_run(more.path).rows.height > whole.rows.height
    assert more.manifest.places == places


@pytest.mark.slow
def test_an_object_of_the_caller_travels_to_an_actor_of_the_same_priority(tmp_path):
    """The standard library cannot pickle a closure, but Ray can."""
    priority = os.nice(0)

    def model(frame1, frame2):
        assert os.nice(0) == priority, "Ray's workers have nice 15 by default"
        return np.full((*frame1.shape[:2], 2), 0.25, np.float32)

    one = {"corruptions": ["contrast"], "severities": [1]}
    result = rf.evaluate(model, output=tmp_path / "run", engine="ray", workers=1, **one)
    assert result.rcre == 0.0


def test_first_pair_is_compared_where_it_is_predicted(tmp_path):
    calls = []

    def negated(frame1, frame2):
        calls.append(1)
        return -rf.load_model("farneback").predict(frame1, frame2)

    few = {"corruptions": ["contrast"], "severities": [1]}
    with pytest.warns(UserWarning, match="'motorcycle'"):
        rf.evaluate(negated, "demo", output=tmp_path / "run", engine="ray", workers=1, **few)
    assert not calls, "the actor has a copy of the list"


def test_object_that_cannot_be_pickled_is_refused(tmp_path):
    class Open(ZeroFlow):
        def __init__(self) -> None:
            super().__init__()
            self.socket = socket.socket()

    refusal(lambda: _evaluate(tmp_path, Open()), UsageError, "model")


def test_without_ray_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    refusal(lambda: _evaluate(tmp_path, DIS), AssetError, "ray")


@pytest.mark.parametrize(
    ("address", "error"),
    [
        ("nonsense", UsageError),
        ("127.0.0.1:1", RunError),
        ("ray://127.0.0.1:1", RunError),
        ("no-such-host.invalid:6379", RunError),
        ("auto", RunError),
    ],
)
def test_address_without_a_cluster_is_refused(tmp_path, monkeypatch, address, error):
    # "auto" uses this address even if a different test's cluster is running
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    started = time.monotonic()
    refusal(lambda: _evaluate(tmp_path, DIS, address=address), error, "--address")
    assert time.monotonic() - started < 30


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_address_of_a_different_service_is_refused(tmp_path, scheme, monkeypatch):
    monkeypatch.setattr("robustflow.run.engines.ray_cluster.REACH_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"{scheme}127.0.0.1:{silent.getsockname()[1]}"
        refusal(lambda: _evaluate(tmp_path, DIS, address=address), RunError, "--address")


@pytest.mark.parametrize("devices", ["cuda:1", "cuda:0,cuda:1"])
def test_gpu_number_is_refused_with_ray(tmp_path, devices):
    spec = ModelRef.parse("tests.run.models_for_tests:Faulty", (("device", devices),))
    refusal(lambda: _evaluate(tmp_path, spec), UsageError, "--device")


@pytest.mark.parametrize("fault", ["lock", "stop"])
def test_a_worker_that_cannot_answer_is_stopped_with_its_model(tmp_path, monkeypatch, fault):
    monkeypatch.setenv("FAULTS", str(tmp_path))
    spec = ModelRef.parse("tests.run.models_for_tests:Faulty", (("fault", fault),))
    with pytest.raises(ModelError) as caught:
        _evaluate(tmp_path, spec, workers=1, timeout=1.5)
    assert caught.value.culprit.startswith("sample '")
    wait_until(lambda: not is_running(int((tmp_path / "failed").read_text())), within_s=10)


def test_a_local_cluster_listens_on_the_loopback_only():
    with connected(None, 1) as ray:
        ray.get(ray.remote(lambda: None).remote())
        owned = {os.readlink(fd) for pid in (os.getpid(), *descendants(os.getpid())) for fd in _descriptors(pid)}
        addresses = []
        for table in ("tcp", "tcp6"):
            for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
                _, local, _, state, *_, inode = line.split()[:10]
                if state == "0A" and f"socket:[{inode}]" in owned:
                    addresses.append(local.partition(":")[0])
    assert len(addresses) > 3
    assert set(addresses) <= {"0100007F", f"{0:016X}FFFF00000100007F", f"{0:024X}01000000"}


def _descriptors(pid: int) -> list[Path]:
    with suppress(OSError):
        return [path for path in Path(f"/proc/{pid}/fd").iterdir() if path.is_symlink()]
    return []


def _start(folder: Path, *options: str, **variables: str) -> subprocess.Popen[str]:
    engine = ["--engine", "ray", "--workers", "2", "--corruptions", ",".join(FAST)]
    return start_run(folder, "Faulty", "-O", "pause=0.2", *engine, *options, **variables)


@pytest.mark.slow
def test_a_killed_agent_of_ray_ends_the_run_with_a_sentence(tmp_path):
    run = _start(tmp_path / "run", "--no-examples")
    wait_until(lambda: rows_so_far(tmp_path / "run").height, run)
    agents = [number for number, line in descendants(run.pid).items() if "RuntimeEnvAgent" in line]
    assert agents
    for agent in agents:
        os.kill(agent, signal.SIGKILL)
    _, err = run.communicate(timeout=60)
    assert run.returncode == 1
    assert err.splitlines()[-1].startswith("robustflow: ")
    assert rows_so_far(tmp_path / "run").height


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["processes", "ray"])
@pytest.mark.parametrize("fault", ["lock", "stop"])
def test_a_worker_that_hangs_ends_with_its_killed_driver(tmp_path, engine, fault):
    run = start_run(tmp_path / "run", "Faulty", "-O", f"fault={fault}", "--engine", engine, FAULTS=str(tmp_path))
    failed = tmp_path / "failed"
    wait_until(lambda: failed.exists() and failed.read_text(), run)
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    wait_until(lambda: not is_running(int(failed.read_text())), within_s=20)
    wait_until(lambda: not list(Path(os.environ["TMPDIR"]).glob("rf-*")), within_s=20)


@pytest.mark.slow
def test_nothing_of_a_cluster_outlives_a_driver_killed_while_it_starts(tmp_path):
    run = _start(tmp_path / "run", "--no-examples")
    wait_until(lambda: any("gcs_server" in line for line in descendants(run.pid).values()), run)
    started = [number for number, line in descendants(run.pid).items() if "/ray/" in line]
    assert started
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    wait_until(lambda: not any(map(is_running, started)), within_s=10)
    wait_until(lambda: not list(Path(os.environ["TMPDIR"]).glob("rf-*")), within_s=10)


@pytest.mark.slow
def test_a_killed_driver_is_resumed_by_another_engine(tmp_path):
    run = _start(tmp_path / "killed", "--no-examples")
    wait_until(lambda: rows_so_far(tmp_path / "killed").height, run)
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    finished = rows_so_far(tmp_path / "killed").height
    assert 0 < finished < 1 + 5 * len(FAST)
    spec = ModelRef.parse("tests.run.models_for_tests:Faulty", (("pause", 0.0),))
    resumed = rf.evaluate(spec, output=tmp_path / "killed", corruptions=FAST)
    whole = rf.evaluate(spec, output=tmp_path / "whole", corruptions=FAST)
    assert resumed.rows.equals(whole.rows)
    assert (resumed.path / "summary.json").read_bytes() == (whole.path / "summary.json").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
def test_ctrl_c_with_ray_prints_one_line(tmp_path, delay):
    check_stopped_by_ctrl_c(_start(tmp_path / "run", "-O", "fault=hang", FAULTS=str(tmp_path)), delay)
    assert not list(Path(os.environ["TMPDIR"]).iterdir()), "an actor that is killed leaves no files"
