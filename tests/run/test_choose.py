"""The engine chosen for a run."""

import sys
import threading
from types import ModuleType, SimpleNamespace

import pytest

from robustflow.core.errors import UsageError
from robustflow.corruptions.registry import IMAGE_PAIR
from robustflow.models import ModelSpec
from robustflow.run.engines import choose
from robustflow.run.engines.choose import choose_engine
from robustflow.run.named_model import NamedModel
from robustflow.run.plan import Unit

UNITS = [Unit("a", "clean", (0,)), Unit("a", "fog", (1, 2, 3, 4, 5)), Unit("a", "snow", (1, 2))]


class Model:
    def __init__(self, device):
        self.device = device


class Light(Model):
    single_threaded = True


def _on_gpu(devices="cuda:0", kind=Model):
    """A named model on the first of its devices."""
    return NamedModel(ModelSpec("raft", (("device", devices),)), kind(devices.partition(",")[0]), {}, None)


ON_CPU = NamedModel(ModelSpec("raft"), Model("cpu"), {}, None)
LIGHT = NamedModel(ModelSpec("dis"), Light("cpu"), {}, None)
PAIR = [Unit("a", "clean", (0,)), *(Unit("a", name, (1, 2, 3, 4, 5)) for name in IMAGE_PAIR)]
THREE_PAIRS = PAIR * 3


def _describe(model, units=UNITS, name=None, workers=None, timeout=None, others=()):
    return choose_engine(name, workers, timeout, None, model, others).describe(units)


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
        (ON_CPU, {"name": "processes"}, "processes, 1 worker"),
        (_on_gpu(), {}, "processes, 1 device + 4 feeders"),
        (_on_gpu(), {"workers": 1}, "processes, 1 device + 1 feeder"),
        (_on_gpu(), {"workers": 50}, "processes, 1 device + 8 feeders"),
        (_on_gpu(), {"timeout": 3.0}, "processes, 1 device + 4 feeders"),
        (_on_gpu(), {"name": "serial"}, "serial"),
        (_on_gpu("cuda:0,cuda:1,cuda:2"), {}, "processes, 3 devices + 4 feeders"),
        (LIGHT, {}, "serial"),
        (LIGHT, {"units": PAIR[:10]}, "serial"),  # 46 cells, too few to start a second process
        (LIGHT, {"units": PAIR[:11]}, "processes, 2 workers"),
        (LIGHT, {"units": THREE_PAIRS}, "processes, 4 workers"),
        (LIGHT, {"units": THREE_PAIRS, "workers": 1}, "serial"),
        (LIGHT, {"units": THREE_PAIRS, "workers": 3}, "processes, 3 workers"),
        (LIGHT, {"units": [Unit(str(number), "clean", (0,)) for number in range(90)]}, "processes, 3 workers"),
        (_on_gpu(kind=Light), {"units": THREE_PAIRS}, "processes, 1 device + 4 feeders"),
        (NamedModel(None, Light("cpu"), {}, None), {"units": THREE_PAIRS}, "serial"),  # cannot be loaded by name
    ],
)
def test_the_engine_follows_from_the_model_the_options_and_the_length_of_the_run(model, options, engine):
    assert _describe(model, **options) == engine


def test_too_few_workers_and_an_address_without_ray_are_refused():
    with pytest.raises(UsageError, match="2 workers are too few for 3 devices"):
        _describe(_on_gpu("cuda:0,cuda:1,cuda:2"), workers=2)
    with pytest.raises(UsageError, match="--address applies only to the ray engine"):
        choose_engine(None, None, None, "auto", LIGHT)


def test_number_of_workers_is_limited_on_a_large_machine(monkeypatch):
    monkeypatch.setattr(choose, "available_processors", lambda: 96)
    assert _describe(LIGHT, PAIR * 80) == "processes, 8 workers"
    assert _describe(LIGHT, PAIR * 80, workers=40) == "processes, 40 workers"


def test_model_that_cannot_be_pickled_runs_in_this_process_unless_workers_are_requested():
    here = NamedModel(None, Model("cuda:0"), {}, None)
    here.model.run = lambda: None
    assert _describe(here) == "serial (this model object cannot be sent to another process)"
    # requested explicitly, so an error is raised on startup
    assert _describe(here, workers=2) == "processes, 1 device + 2 feeders"


def test_data_that_cannot_be_pickled_stay_in_this_process_unless_workers_are_requested():
    others = (threading.Lock(),)
    why = "serial (this dataset or corruption cannot be sent to another process)"
    assert _describe(LIGHT, THREE_PAIRS, others=others) == why
    assert _describe(_on_gpu(), others=others) == why
    assert _describe(LIGHT, THREE_PAIRS, workers=2, others=others) == "processes, 2 workers"
    assert _describe(LIGHT, others=others) == "serial", "too short for processes anyway, so no reason is given"


def test_data_of_a_class_from_a_notebook_stay_in_this_process(monkeypatch):
    notebook = ModuleType("__main__")  # there is no file that a process could load
    notebook.Mine = type("Mine", (), {"__module__": "__main__"})
    monkeypatch.setitem(sys.modules, "__main__", notebook)
    assert _describe(LIGHT, THREE_PAIRS, others=(notebook.Mine(),)).startswith("serial (this dataset")
    assert _describe(LIGHT, THREE_PAIRS) == "processes, 4 workers"


def test_script_without_a_main_guard_runs_in_one_process_and_states_the_reason(tmp_path, monkeypatch):
    script = tmp_path / "script.py"
    main = SimpleNamespace(__file__=str(script), __spec__=None)
    monkeypatch.setitem(sys.modules, "__main__", main)
    script.write_text("import robustflow\n")
    why = "serial (worker processes require the script's code to be under `if __name__"
    assert _describe(_on_gpu()).startswith(why)
    assert _describe(LIGHT, THREE_PAIRS).startswith(why)
    script.write_text('if __name__ == "__main__":\n    pass\n')
    assert _describe(_on_gpu()) == "processes, 1 device + 4 feeders"
    script.write_text("import robustflow\n")
    main.__spec__ = SimpleNamespace(name="package.__main__")  # python -m package
    assert _describe(LIGHT, THREE_PAIRS) == "processes, 4 workers"


def test_a_worker_starts_no_workers(monkeypatch):
    monkeypatch.setattr(choose.multiprocessing, "parent_process", SimpleNamespace)
    assert _describe(LIGHT, THREE_PAIRS).startswith("serial (this process is itself a worker")
