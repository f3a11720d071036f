"""Every engine computes the same rows and summary, in one go or resumed, whatever a run measures."""

from __future__ import annotations

import os
import threading
import time
from functools import partial
from multiprocessing.connection import wait
from unittest.mock import Mock

import pytest

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.models import ModelRef
from robustflow.run.engines.base import Engine
from robustflow.run.engines.processes import processes, serial
from robustflow.run.plan import Job, Unit, name_model
from robustflow.run.progress import Silent
from robustflow.run.store import RunFolder
from robustflow.testing import TexturePairs, ZeroFlow

from ..refusals import refusal
from .models_for_tests import NotRestored
from .processes import wait_until

MODELS = "tests.run.models_for_tests"
KINDS = {
    "pairs": {},
    "clips": {"model": "FiveFrames"},
    "still scenes": {"still": True, "draws": 2},
    "confidence from the flow back": {"confidence": "forward-backward"},
    "confidence of the model": {"confidence": "model"},
    "depth": {
        "benchmark": "shapes",
        "data": None,
        "data_options": {"pairs": 2, "size": "64x96"},
        "corruptions": ("contrast", "fog_3d", "fog+fog_3d:2"),
    },
}


@pytest.mark.parametrize("kind", KINDS)
def test_engines_and_halves_make_the_same_rows(kind, clip_folder, tmp_path):
    given = {"model": "Sure", "benchmark": "folder", "data": clip_folder, "corruptions": ("contrast", "impulse_noise")}
    given |= {"severities": [1, 4], "limit": 2} | KINDS[kind]
    name = f"{MODELS}:{given.pop('model')}"

    def run(folder, model=name, **options):
        return rf.evaluate(model, output=tmp_path / folder, **{**given, **options})

    whole = run("whole", engine="serial")
    half = run("halves", corruptions=given["corruptions"][1:], severities=[4], workers=2)
    assert half.rows.height == 2 * len(given["corruptions"]), "clean and all but the first"
    halves = run("halves")
    device = ModelRef.parse(name, (("device", "cuda:0"),))
    staged = run("staged", device, engine="processes", workers=1, batch_size=1 if kind == "clips" else 2)
    assert whole.rows.height == 2 * (1 + 2 * len(given["corruptions"]))
    assert staged.rows.equals(whole.rows)
    assert halves.rows.equals(whole.rows)
    assert (halves.path / "summary.json").read_bytes() == (whole.path / "summary.json").read_bytes()


@pytest.mark.parametrize("model", ["Sure", "Accelerated"])
def test_a_dataset_that_cannot_be_sent_to_workers_is_named(tmp_path, model):
    data = TexturePairs(1, (24, 32))
    data.file = threading.Lock()
    benchmark = rf.Benchmark("mine", data, ("0",), ("contrast",))
    run = partial(rf.evaluate, f"{MODELS}:{model}", benchmark, output=tmp_path / "run", engine="processes")
    refusal(run, UsageError, "dataset or corruption")


@pytest.mark.parametrize("model", ["Sure", "Accelerated"])
def test_a_dataset_that_workers_cannot_restore_is_a_usage_error(tmp_path, model):
    data = NotRestored(1, (24, 32))
    benchmark = rf.Benchmark("mine", data, ("0",), ("contrast",))
    run = partial(rf.evaluate, f"{MODELS}:{model}", benchmark, output=tmp_path / "run", engine="processes", workers=1)
    refusal(run, UsageError, "model, dataset or corruption")


def test_an_engine_does_not_start_without_units(tmp_path, monkeypatch):
    started = []

    def compute(job, units):
        started.append(len(units))
        yield from serial(job, units)

    monkeypatch.setattr("robustflow.run.engines.choose.SERIAL", Engine(lambda units: "", compute))
    for _ in range(2):
        rf.evaluate(ZeroFlow(), output=tmp_path, corruptions=["contrast"], severities=[1])
    assert started == [2]


def test_four_units_are_prepared_and_rows_written_while_the_model_works(tmp_path, monkeypatch):
    loaded = []

    class Pairs(TexturePairs):
        def load(self, key):
            loaded.append(key)
            return super().load(key)

    class Waits(ZeroFlow):
        """Every prediction ends once the pairs of the three units after its own are read."""

        calls = 0

        def predict(self, frame1, frame2):
            self.calls += 1
            wait_until(lambda: len(loaded) >= min(len(keys), (self.calls + 3) // 2))
            assert len(loaded) <= (self.calls + 4) // 2
            return super().predict(frame1, frame2)

    def write(folder, unit, rows, write=RunFolder.write_rows):
        before = model.calls
        wait_until(lambda: model.calls > before or unit != Unit(keys[0], "clean", (0,)))
        write(folder, unit, rows)

    data = Pairs(9, (24, 32))
    keys = data.keys()
    benchmark = rf.Benchmark("mine", data, tuple(keys), ("contrast",), (1,))
    model = Waits()
    loaded.clear()
    monkeypatch.setattr(RunFolder, "write_rows", write)
    assert rf.evaluate(model, benchmark, output=tmp_path).rows.height == model.calls - 1 == 2 * len(keys)
    assert sorted(loaded) == keys


def test_order_of_predictions_does_not_depend_on_the_speed_of_the_model(tmp_path):
    """Otherwise a model that draws random numbers would not predict the same flows again."""

    class Slow(ZeroFlow):
        def __init__(self, pauses):
            super().__init__()
            self.pauses, self.asked = pauses, []

        def predict(self, frame1, frame2):
            time.sleep(self.pauses[len(self.asked) % len(self.pauses)])
            self.asked.append(frame1.tobytes() + frame2.tobytes())
            return super().predict(frame1, frame2)

    models = [Slow([0.0]), Slow([0.03, 0.0, 0.0]), Slow([0.0, 0.0, 0.0, 0.05, 0.01])]
    benchmark = rf.Benchmark("mine", TexturePairs(3, (24, 32)), tuple("012"), ("contrast", "impulse_noise"), (1, 3))
    for number, model in enumerate(models):
        rf.evaluate(model, benchmark, output=tmp_path / str(number))
    assert models[0].asked == models[1].asked == models[2].asked


def test_error_is_the_first_in_the_plan_and_earlier_units_are_kept(tmp_path):
    """The pair that fails is read while the model works on the first one."""

    class Fails(TexturePairs):
        def load(self, key):
            if key in "12":
                raise OSError(key)
            return super().load(key)

    benchmark = rf.Benchmark("mine", Fails(4, (24, 32)), tuple("0123"), ("contrast",), (1, 2, 3, 4, 5))
    run = partial(rf.evaluate, ZeroFlow(), benchmark, output=tmp_path)
    assert "'1'" in str(refusal(run, UsageError, "the dataset 'texture_pairs'"))
    assert RunFolder(tmp_path).rows()["sample"].to_list() == ["0"] * 6


def test_time_spent_on_writing_rows_is_no_prediction_time(tmp_path, monkeypatch):
    """Sample 1 is being predicted while the rows of sample 0 are written, which takes longer than the timeout."""
    monkeypatch.setenv("PREDICTION_LOG", os.devnull)
    clock = Mock(wraps=time)
    monkeypatch.setattr("robustflow.run.engines.processes.time", clock)
    monkeypatch.setattr("robustflow.run.engines.processes.wait", lambda pipes, timeout: wait(pipes))
    data = TexturePairs(2, (24, 32))
    model = ModelRef.parse(f"{MODELS}:Logged", (("shape", "24x32"), ("marks", str(tmp_path))))
    (tmp_path / "clean").mkdir()
    job, units, finished = Job(data, name_model(model), folder=tmp_path), [Unit(key, "clean", (0,)) for key in "01"], []
    for done in processes(job, units, 2, 100):
        (tmp_path / "rows of 0").touch()
        clock.monotonic = lambda: time.monotonic() + 200
        finished.append(done.unit.key)
    assert finished == ["0", "1"]


def test_ctrl_c_while_an_engine_ends_is_raised_and_not_printed(tmp_path, monkeypatch):
    """Ctrl-C may arrive twice, once from Python and once from a library that watches for it, such as polars."""

    def compute(job, units):
        try:
            yield from serial(job, units)
        except GeneratorExit:
            raise KeyboardInterrupt("second") from None

    class Stopped(Silent):
        def advance(self, done):
            raise KeyboardInterrupt("first")

    monkeypatch.setattr("robustflow.run.engines.choose.SERIAL", Engine(lambda units: "", compute))
    with pytest.raises(KeyboardInterrupt, match="second"):
        rf.evaluate(ZeroFlow(), output=tmp_path, severities=[1], progress=Stopped())
