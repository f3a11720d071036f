"""Whatever fails on a Ray cluster, the run has the same rows as an undisturbed run, with each cell only once."""

from __future__ import annotations

import hashlib
import os
import pickle
import random
import re
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, ModelError, RunError
from robustflow.data.video.prepare import Preparation
from robustflow.data.video.prepare_folder import find_sources, prepare_folder
from robustflow.media.images import write_image
from robustflow.models import ModelRef
from robustflow.run.engines.ray_actor import Start, UnitActor, installed
from robustflow.run.engines.ray_prepare import prepare_on_ray
from robustflow.run.plan import Job, Unit, name_model
from tests.data.video import clips

from .conftest import FAST
from .processes import rows_so_far
from .ray_nodes import cluster

pytestmark = pytest.mark.ray

PAIRS = 5
PLAIN = Preparation(fps=Fraction(240), factor=1, step=16, preset="ultrafast")


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """A folder of a few small frames, with at least as many unrelated pairs as workers that the test may lose."""
    folder = tmp_path_factory.mktemp("frames")
    draws = np.random.default_rng(0)
    for number in range(PAIRS + 1):
        write_image(folder / f"{number:02d}.png", draws.integers(0, 256, (48, 64, 3), np.uint8))
    return folder


@pytest.fixture(scope="module")
def on_path():
    """Make `models_for_tests` importable on nodes."""
    with pytest.MonkeyPatch.context() as patch:
        folder = str(Path(__file__).parents[2])
        patch.setenv("PYTHONPATH", os.pathsep.join([folder, *filter(None, [os.environ.get("PYTHONPATH")])]))
        yield


@pytest.fixture(scope="module")
def two_nodes(on_path, tmp_path_factory):
    """A cluster of two nodes with one CPU and one simulated GPU each."""
    faults = tmp_path_factory.mktemp("faults")
    with cluster({"FAULTS": str(faults)}, gpus=1) as nodes:
        yield nodes


@pytest.fixture
def faults(tmp_path_factory, two_nodes):
    """Return an empty folder in which the nodes record their faults."""
    folder = Path(os.environ["FAULTS"])
    for each in folder.iterdir():
        each.unlink()
    return folder


def _run(folder, frames, **options):
    model = ModelRef.parse("tests.run.models_for_tests:Faulty", tuple(options.pop("model", {}).items()))
    return rf.evaluate(model, "folder", frames, folder, corruptions=FAST, **options)


@pytest.fixture(scope="module")
def reference_run(on_path, frames, tmp_path_factory):
    return _run(tmp_path_factory.mktemp("reference_run") / "run", frames)


def _check_equal(result, reference_run):
    assert result.rows.equals(reference_run.rows)
    cells = result.rows.select("sample", "corruption", "severity")
    assert cells.n_unique() == cells.height == PAIRS * (1 + 5 * len(FAST))
    assert (result.path / "summary.json").read_bytes() == (reference_run.path / "summary.json").read_bytes()


def test_every_actor_has_a_separate_gpu(two_nodes, frames, reference_run, tmp_path, faults):
    log = faults.parent / "gpus.log"
    model = {"device": "cuda", "pause": 0.02, "log": str(log)}
    result = _run(tmp_path / "run", frames, model=model, **two_nodes.engine)
    _check_equal(result, reference_run)
    assert sum(result.manifest.places.values()) == PAIRS * (1 + len(FAST))
    assert all(place.endswith(", GPU 0") for place in result.manifest.places)
    users = {line.split()[0]: line.split()[1] for line in log.read_text().splitlines()}
    on_nodes = {pid: gpu for pid, gpu in users.items() if gpu != "None"}
    assert set(on_nodes.values()) == {"0"}
    assert len(on_nodes) == 2, "one actor per GPU"


def test_killed_actor_loses_no_row_and_its_node_is_named(two_nodes, frames, reference_run, tmp_path, faults):
    result = _run(tmp_path / "run", frames, model={"fault": "exit"}, **two_nodes.engine)
    _check_equal(result, reference_run)
    places = result.manifest.places
    assert sum(places.values()) == PAIRS * (1 + len(FAST))
    assert all(place.endswith(", CPU") for place in places)
    assert len(list(faults.iterdir())) == 1


def _evaluate_trouble(kind, frames, folder, **options):
    model = ModelRef.parse("tests.run.models_for_tests:Trouble", (("trouble", kind),))
    rf.evaluate(model, "folder", frames, folder, limit=1, **options)


def test_a_unit_that_ends_every_actor_is_named(two_nodes, frames, tmp_path, capfd):
    with pytest.raises(RunError) as caught:
        _evaluate_trouble("dies", frames, tmp_path / "run", workers=1, **two_nodes.engine)
    assert re.fullmatch("sample '.*', clean", caught.value.culprit)
    assert len(re.findall(r"node \S+ \(ActorDiedError\)", str(caught.value))) == 3
    assert "models_for_tests:Trouble" in str(caught.value)
    assert "--workers" not in str(caught.value)
    assert "raylet" not in "".join(capfd.readouterr()), "Ray's own messages do not appear in the output"


def test_a_model_that_hangs_is_stopped(two_nodes, frames, tmp_path, faults):
    options = {"workers": 1, "model": {"fault": "hang"}, "timeout": 0.5, **two_nodes.engine}
    with pytest.raises(ModelError) as caught:
        _run(tmp_path / "run", frames, **options)
    assert caught.value.culprit.startswith("sample '")
    assert " 0.5 " in str(caught.value)


@pytest.mark.slow
def test_worker_killed_for_its_memory_loses_no_row(on_path, frames, reference_run, tmp_path):
    """Ray's memory monitor kills a worker when the machine's memory is nearly full; this test sets the limit to 4 GB
    above current use, or to half of the free memory, so that other processes on the machine do not reach it.
    """
    amounts = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
    total, free = (int(amounts[name].split()[0]) for name in ("MemTotal", "MemAvailable"))
    limit = 1 - max(free - 4e6, free / 2) / total
    (tmp_path / "faults").mkdir()
    variables = {"RAY_memory_usage_threshold": f"{limit:.3f}", "RAY_memory_monitor_refresh_ms": "100"}
    with cluster({**variables, "FAULTS": str(tmp_path / "faults")}) as nodes:
        _check_equal(_run(tmp_path / "run", frames, model={"fault": "memory"}, **nodes.engine), reference_run)
    assert len(list((tmp_path / "faults").iterdir())) == 1


def test_errors_of_the_model_are_reported_with_the_node(two_nodes, frames, tmp_path):
    with pytest.raises(ModelError) as raised:
        _evaluate_trouble("raises", frames, tmp_path / "run", workers=1, **two_nodes.engine)
    with pytest.raises(ModelError) as expected:
        _evaluate_trouble("raises", frames, tmp_path / "other", engine="processes", workers=1)
    message, node, _ = str(raised.value).rpartition(" (on node ")
    assert node
    assert message == str(expected.value)


@pytest.mark.slow
def test_nodes_killed_at_ten_moments_leave_the_same_rows(two_nodes, frames, reference_run, tmp_path):
    """A node is killed at a random moment and a new one joins, again and again over several runs."""
    moments = random.Random(1)
    killed = number = 0
    with ThreadPoolExecutor(1) as other:  # nodes can only be added from the main thread
        while killed < 10:
            folder = tmp_path / f"run{number}"
            options = {"model": {"pause": 0.1}, **two_nodes.engine}
            run = other.submit(_run, folder, frames, **options)
            before = 0
            while killed < 10 and not run.done():
                if rows_so_far(folder).height > before:  # wait for progress between two kills
                    time.sleep(moments.uniform(0.0, 1.0))
                    two_nodes.kill(two_nodes.alive[moments.randrange(2)])
                    killed += not run.done()
                    before = rows_so_far(folder).height
                    two_nodes.add(gpus=1)
                time.sleep(0.05)
            _check_equal(run.result(), reference_run)
            number += 1


@pytest.mark.slow
def test_every_node_is_killed_and_others_join(two_nodes, frames, reference_run, tmp_path):
    """All nodes are lost; a node that joins later continues with the remaining cells."""
    options = {"model": {"pause": 0.1}, **two_nodes.engine}
    with ThreadPoolExecutor(1) as other:  # nodes can only be added from the main thread
        run = other.submit(_run, tmp_path / "run", frames, **options)
        while not rows_so_far(tmp_path / "run").height and not run.done():
            time.sleep(0.05)
        for node in list(two_nodes.alive):
            two_nodes.kill(node)
        finished = rows_so_far(tmp_path / "run").height
        two_nodes.add(gpus=1)
        two_nodes.add(gpus=1)
        _check_equal(run.result(), reference_run)
    assert finished < reference_run.rows.height


def test_a_node_without_the_package_is_named(two_nodes, frames, tmp_path, monkeypatch):
    (tmp_path / "shadow" / "robustflow").mkdir(parents=True)
    (tmp_path / "shadow" / "robustflow" / "__init__.py").write_text("raise ImportError('no such package')")
    with monkeypatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "shadow"), os.environ["PYTHONPATH"]]))
        odd = two_nodes.add()
    slow = {"pause": 1.0}  # the others must not finish the run before the third has started
    with pytest.raises(RunError) as caught:
        _run(tmp_path / "run", frames, workers=3, model=slow, **two_nodes.engine)
    assert caught.value.culprit.startswith("node ")
    assert "ImportError" in str(caught.value)
    two_nodes.kill(odd)


def test_a_node_without_the_data_or_with_another_model_is_named(frames, tmp_path, monkeypatch):
    """The checks on a node before it loads a sample; the node is this machine, so the actor is called directly."""
    monkeypatch.setattr("robustflow.run.engines.ray_actor._device", lambda: "CPU")
    size = (frames / "00.png").stat().st_size
    here = Job(rf.load_dataset("folder", frames), name_model("farneback"))
    elsewhere = replace(here, model=replace(here.model, identity={"source": "another"}))
    job = pickle.dumps(here)
    start = Start({}, os.getcwd(), [], installed())
    node = f"node {socket.gethostname()}"
    actor = UnitActor()
    assert actor.begin(b"", start, None)[0] == "error", "not a job"
    assert actor.begin(job, start, None) == ("done", f"{socket.gethostname()}, CPU")
    unit = Unit("00", "clean", (0,))
    for call, expected, part in (
        (lambda: actor.run(unit, [(str(frames / "gone.png"), size)]), "DataError", "gone.png"),
        (lambda: actor.run(unit, [(str(frames / "00.png"), size + 1)]), "DataError", f" {size} "),
        (lambda: actor.begin(pickle.dumps(elsewhere), start, None), "RunError", "source"),
        (lambda: actor.begin(job, replace(start, installed={"numpy": "0.1"}), None), "RunError", "numpy"),
    ):
        kind, (error, message, _, culprit) = call()
        assert (kind, error, culprit) == ("error", expected, node)
        assert part in message


def test_clips_are_prepared_into_the_same_files_as_without_ray(two_nodes, tmp_path):
    clips.folder(tmp_path / "data" / "one", 70)
    clips.folder(tmp_path / "data" / "two", 70, 32, 48)
    sources = find_sources(tmp_path / "data")
    prepare_folder(sources, tmp_path / "plain", PLAIN)
    on_ray = partial(prepare_on_ray, address=two_nodes.address)
    heard = []
    prepare_folder(sources, tmp_path / "ray", PLAIN, progress=lambda *said: heard.append(said), prepare_all=on_ray)
    assert [said[1:] for said in heard] == [("clips", 1, 2), ("clips", 2, 2)]
    assert _contents(tmp_path / "ray") == _contents(tmp_path / "plain"), "no other files are left"
    other = Preparation(fps=Fraction(240), factor=1, step=17, preset="ultrafast")
    with pytest.raises(DataError) as caught:
        prepare_folder(sources, tmp_path / "ray", other, prepare_all=on_ray)
    assert caught.value.culprit in (str(tmp_path / "ray/one"), str(tmp_path / "ray/two"))
    assert f"node {socket.gethostname()}" in str(caught.value)


def _contents(folder: Path) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
