"""The engine chosen for a run."""

import sys
import threading
from functools import partial
from types import ModuleType, SimpleNamespace

import pytest

from robustflow.core.errors import UsageError
from robustflow.corruptions.registry import IMAGE_PAIR
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelRef
from robustflow.run.config import Compute, RunConfig
from robustflow.run.engines import choose
from robustflow.run.engines.base import pickled
from robustflow.run.engines.choose import choose_engine
from robustflow.run.plan import Job, NamedModel, Plan, Unit
from robustflow.testing import TexturePairs

from ..refusals import refusal

UNITS = [Unit("a", "clean", (0,)), Unit("a", "fog", (1, 2, 3, 4, 5)), Unit("a", "snow", (1, 2))]


class Model:
    def __init__(self, device):
        self.device = device


class Light(Model):
    single_threaded = True


def _on_gpu(devices="cuda:0", kind=Model):
    """A named model on the first of its devices."""
    return NamedModel(ModelRef.parse("raft", (("device", devices),)), kind(devices.partition(",")[0]), {})


ON_CPU = NamedModel(ModelRef.parse("raft"), Model("cpu"), {})
LIGHT = NamedModel(ModelRef.parse("dis"), Light("cpu"), {})
PAIR = [Unit("a", "clean", (0,)), *(Unit("a", name, (1, 2, 3, 4, 5)) for name in IMAGE_PAIR)]
THREE_PAIRS = PAIR * 3


def _plan(model, dataset=None, attacks=(), **compute):
    benchmark = Benchmark("drawn", dataset or TexturePairs(1), ("0",), (), attacks=attacks)
    return Plan(benchmark, model, RunConfig(compute=Compute(**compute)))


def _describe(model, units=UNITS, **given):
    return choose_engine(_plan(model, **given)).describe(units)


@pytest.fixture(autouse=True)
def four_processors(monkeypatch):
    monkeypatch.setattr(choose, "available_processors", lambda: 4)


@pytest.mark.parametrize(
    ("model", "options", "engine"),
    [
        (ON_CPU, {}, "serial"),
        (ON_CPU, {"workers": 1}, "serial"),
        (ON_CPU, {"workers": 2}, "processes, 2 workers"),
        (ON_CPU, {"workers": 9}, "processes, 3 workers"),
        (ON_CPU, {"timeout": 3.0}, "processes, 1 worker"),
        (ON_CPU, {"engine": "processes"}, "processes, 1 worker"),
        (_on_gpu(), {}, "processes, 1 device + 3 feeders"),
        (_on_gpu(), {"workers": 1}, "processes, 1 device + 1 feeder"),
        (_on_gpu(), {"workers": 50}, "processes, 1 device + 3 feeders"),
        (_on_gpu(), {"workers": 200, "units": THREE_PAIRS}, "processes, 1 device + 48 feeders"),
        (_on_gpu(), {"timeout": 3.0}, "processes, 1 device + 3 feeders"),
        (_on_gpu(), {"engine": "serial"}, "serial"),
        (_on_gpu("cuda:0,cuda:1,cuda:2"), {}, "processes, 3 devices + 3 feeders"),
        (LIGHT, {}, "serial"),
        (LIGHT, {"units": PAIR[:10]}, "serial"),  # 46 cells, too few to start a second process
        (LIGHT, {"units": PAIR[:11]}, "processes, 2 workers"),
        (LIGHT, {"units": THREE_PAIRS}, "processes, 4 workers"),
        (LIGHT, {"units": THREE_PAIRS, "workers": 1}, "serial"),
        (LIGHT, {"units": THREE_PAIRS, "workers": 3}, "processes, 3 workers"),
        (LIGHT, {"units": [Unit(str(number), "clean", (0,)) for number in range(90)]}, "processes, 3 workers"),
        (_on_gpu(kind=Light), {"units": THREE_PAIRS}, "processes, 1 device + 4 feeders"),
        (NamedModel(None, Light("cpu"), {}), {"units": THREE_PAIRS}, "serial"),  # cannot be loaded by name
    ],
)
def test_the_engine_follows_from_the_model_the_options_and_the_length_of_the_run(model, options, engine):
    assert _describe(model, **options) == engine


REFUSALS = [
    (_on_gpu("cuda:0,cuda:1,cuda:2"), {"workers": 2}, "--workers"),
    (LIGHT, {"address": "auto"}, "--address"),
    (LIGHT, {"engine": "serial", "workers": 2}, "--workers"),
    (LIGHT, {"engine": "serial", "timeout": 1.0}, "--timeout"),
    (LIGHT, {"engine": "parallel"}, "parallel"),
    (_on_gpu(), {"attacks": ("square",), "engine": "processes"}, "--engine"),
    (_on_gpu(), {"attacks": ("square",), "workers": 2}, "--workers"),
    (_on_gpu(), {"attacks": ("square",), "timeout": 1.0}, "--timeout"),
]


@pytest.mark.parametrize(("model", "options", "culprit"), REFUSALS)
def test_options_that_do_not_fit_the_engine_are_refused(model, options, culprit):
    refusal(lambda: _describe(model, **options), UsageError, culprit)


def test_number_of_workers_is_limited_on_a_large_machine(monkeypatch):
    monkeypatch.setattr(choose, "available_processors", lambda: 96)
    assert _describe(LIGHT, PAIR * 80) == "processes, 8 workers"
    assert _describe(LIGHT, PAIR * 80, workers=40) == "processes, 40 workers"


UNPICKLED = NamedModel(None, Model("cuda:0"), {})
UNPICKLED.model.run = lambda: None
LOCKED = TexturePairs(1)
LOCKED.lock = threading.Lock()


@pytest.mark.parametrize(
    ("model", "options", "engine"),
    [
        (UNPICKLED, {}, "serial (the model"),
        (UNPICKLED, {"workers": 2}, "processes, 1 device + 2 feeders"),  # requested, so starting it raises an error
        (LIGHT, {"units": THREE_PAIRS, "dataset": LOCKED}, "serial (the dataset or corruption"),
        (_on_gpu(), {"dataset": LOCKED}, "serial (the dataset or corruption"),
        (LIGHT, {"units": THREE_PAIRS, "dataset": LOCKED, "workers": 2}, "processes, 2 workers"),
        (LIGHT, {"dataset": LOCKED}, "serial"),  # too short for processes anyway, so no reason is given
    ],
)
def test_what_cannot_be_pickled_stays_in_this_process_unless_workers_are_requested(model, options, engine):
    assert _describe(model, **options).partition(" cannot")[0] == engine


def test_data_of_a_class_from_a_notebook_stay_in_this_process(monkeypatch):
    notebook = ModuleType("__main__")  # there is no file that a process could load
    notebook.Mine = type("Mine", (TexturePairs,), {"__module__": "__main__"})
    monkeypatch.setitem(sys.modules, "__main__", notebook)
    assert _describe(LIGHT, THREE_PAIRS, dataset=notebook.Mine(1)).startswith("serial (")
    refusal(partial(pickled, Job(notebook.Mine(1))), UsageError, "class defined in a notebook or at a prompt")
    assert _describe(LIGHT, THREE_PAIRS) == "processes, 4 workers"


@pytest.mark.parametrize(
    ("script", "module", "engine"),
    [
        ("import robustflow\n", None, "serial "),
        ('if __name__ == "__main__":\n    pass\n', None, "processes, 4 workers"),
        ("import robustflow\n", "package.__main__", "processes, 4 workers"),  # python -m package
    ],
)
def test_script_without_a_main_guard_runs_in_one_process(tmp_path, monkeypatch, script, module, engine):
    (tmp_path / "script.py").write_text(script)
    spec = SimpleNamespace(name=module) if module else None
    main = SimpleNamespace(__file__=str(tmp_path / "script.py"), __spec__=spec)
    monkeypatch.setitem(sys.modules, "__main__", main)
    assert _describe(LIGHT, THREE_PAIRS).partition("(")[0] == engine
    assert _describe(_on_gpu()).startswith(engine.partition(",")[0])


def test_a_worker_starts_no_workers(monkeypatch):
    monkeypatch.setattr(choose.multiprocessing, "parent_process", SimpleNamespace)
    assert _describe(LIGHT, THREE_PAIRS).startswith("serial (")
