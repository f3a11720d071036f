"""The engine chosen for a run."""

import sys
import threading
from types import ModuleType, SimpleNamespace

import pytest

from robustflow.corruptions.registry import IMAGE_PAIR
from robustflow.errors import UsageError
from robustflow.models import ModelSpec
from robustflow.runner.engines import choose
from robustflow.runner.engines.choose import choose_engine
from robustflow.runner.named_model import NamedModel
from robustflow.runs.plan import Unit

UNITS = [Unit("a", "clean", (0,)), Unit("a", "fog", (1, 2, 3, 4, 5)), Unit("a", "snow", (1, 2))]


class Model:
    def __init__(self, device):
        self.device = device


def _named(device="cpu", devices=None):
    spec = ModelSpec("raft", (("device", devices),) if devices else ())
    return NamedModel(spec, Model(device), {}, None)


def _describe(model, name=None, workers=None, timeout=None):
    return choose_engine(name, workers, timeout, None, model).describe(UNITS)


@pytest.fixture(autouse=True)
def four_processors(monkeypatch):
    monkeypatch.setattr(choose, "available_processors", lambda: 4)


@pytest.mark.parametrize(
    ("options", "engine"),
    [
        ({}, "serial"),
        ({"workers": 1}, "serial"),
        ({"workers": 2}, "processes, 2 workers"),
        ({"workers": 9}, "processes, 3 workers"),
        ({"timeout": 3.0}, "processes, 1 worker"),
        ({"name": "processes"}, "processes, 1 worker"),
    ],
)
def test_of_a_model_on_the_processor(options, engine):
    assert _describe(_named(), **options) == engine


@pytest.mark.parametrize(
    ("options", "engine"),
    [
        ({}, "processes, 1 device + 4 feeders"),
        ({"workers": 1}, "processes, 1 device + 1 feeder"),
        ({"workers": 50}, "processes, 1 device + 8 feeders"),
        ({"timeout": 3.0}, "processes, 1 device + 4 feeders"),
        ({"name": "serial"}, "serial"),
    ],
)
def test_of_a_model_on_a_gpu(options, engine):
    assert _describe(_named("cuda:0"), **options) == engine


def test_of_a_model_on_several_gpus():
    model = _named("cuda:0", "cuda:0,cuda:1,cuda:2")
    assert _describe(model) == "processes, 3 devices + 4 feeders"
    with pytest.raises(UsageError, match="2 workers are too few for 3 devices"):
        _describe(model, workers=2)


def test_an_object_that_stays_here_says_why():
    here = NamedModel(None, Model("cuda:0"), {}, None)
    here.model.run = lambda: None
    assert _describe(here) == "serial (this model object cannot be sent to another process)"
    # requested explicitly, so an error is raised on startup
    assert _describe(here, workers=2) == "processes, 1 device + 2 feeders"


class Light(Model):
    single_threaded = True


def _spread(model, units, workers=None, others=()):
    return choose_engine(None, workers, None, None, model, others).describe(units)


def _light(spec="dis"):
    return NamedModel(spec and ModelSpec(spec), Light("cpu"), {}, None)


PAIR = [Unit("a", "clean", (0,)), *(Unit("a", name, (1, 2, 3, 4, 5)) for name in IMAGE_PAIR)]


@pytest.mark.parametrize(
    ("units", "options", "engine"),
    [
        (UNITS, {}, "serial"),
        (PAIR[:10], {}, "serial"),  # 46 cells, too few to start a second process
        (PAIR[:11], {}, "processes, 2 workers"),
        (PAIR * 3, {}, "processes, 4 workers"),
        (PAIR * 3, {"workers": 1}, "serial"),
        (PAIR * 3, {"workers": 3}, "processes, 3 workers"),
        ([Unit(str(number), "clean", (0,)) for number in range(90)], {}, "processes, 3 workers"),
    ],
)
def test_of_a_model_in_one_thread(units, options, engine):
    assert _spread(_light(), units, **options) == engine


def test_not_every_processor_of_a_large_machine(monkeypatch):
    monkeypatch.setattr(choose, "available_processors", lambda: 96)
    assert _spread(_light(), PAIR * 80) == "processes, 8 workers"
    assert _spread(_light(), PAIR * 80, workers=40) == "processes, 40 workers"


def test_a_model_in_one_thread_that_has_no_name_stays_here():
    assert _spread(_light(None), PAIR * 3) == "serial"


def test_a_script_without_a_guard_stays_in_one_process_and_says_why(tmp_path, monkeypatch):
    script = tmp_path / "script.py"
    main = SimpleNamespace(__file__=str(script), __spec__=None)
    monkeypatch.setitem(sys.modules, "__main__", main)
    script.write_text("import robustflow\n")
    why = "serial (worker processes require the script's code to be under `if __name__"
    assert _describe(_named("cuda:0")).startswith(why)
    assert _spread(_light(), PAIR * 3).startswith(why)
    script.write_text('if __name__ == "__main__":\n    pass\n')
    assert _describe(_named("cuda:0")) == "processes, 1 device + 4 feeders"
    script.write_text("import robustflow\n")
    main.__spec__ = SimpleNamespace(name="package.__main__")  # python -m package
    assert _spread(_light(), PAIR * 3) == "processes, 4 workers"


def test_a_worker_starts_no_workers(monkeypatch):
    monkeypatch.setattr(choose.multiprocessing, "current_process", lambda: SimpleNamespace(daemon=True))
    assert _spread(_light(), PAIR * 3).startswith("serial (this process is itself a worker")


def test_an_address_without_ray_is_refused_for_it_too():
    with pytest.raises(UsageError, match="--address applies only to the ray engine"):
        choose_engine(None, None, None, "auto", _light())


def test_a_device_counts_for_more_than_one_thread():
    on_gpu = NamedModel(ModelSpec("raft"), Light("cuda:0"), {}, None)
    assert _spread(on_gpu, PAIR * 3) == "processes, 1 device + 4 feeders"


def test_a_run_too_short_for_processes_gives_no_reason_against_them():
    assert _spread(_light(), UNITS, others=(threading.Lock(),)) == "serial"


def test_data_that_cannot_be_sent_stay_here_unless_asked():
    unsendable = (threading.Lock(),)
    why = "serial (this dataset or corruption cannot be sent to another process)"
    assert _spread(_light(), PAIR * 3, others=unsendable) == why
    assert choose_engine(None, None, None, None, _named("cuda:0"), unsendable).describe(UNITS) == why
    assert _spread(_light(), PAIR * 3, workers=2, others=unsendable) == "processes, 2 workers"


def test_data_of_a_class_of_a_notebook_stay_here(monkeypatch):
    notebook = ModuleType("__main__")  # there is no file that a process could load
    notebook.Mine = type("Mine", (), {"__module__": "__main__"})
    monkeypatch.setitem(sys.modules, "__main__", notebook)
    assert _spread(_light(), PAIR * 3, others=(notebook.Mine(),)).startswith("serial (this dataset")
    assert _spread(_light(), PAIR * 3) == "processes, 4 workers"
