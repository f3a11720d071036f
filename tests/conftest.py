"""Settings shared by all tests: one thread per process, runs without pictures, and the lookup of the
shared real data.
"""

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

for _name in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_name}_NUM_THREADS", "1")
os.environ.setdefault("POLARS_MAX_THREADS", "1")
# MKL gives the same bytes wherever in memory an array lies.
os.environ.setdefault("MKL_CBWR", "AUTO,STRICT")

import cv2
import hypothesis
import numpy as np
import pytest
import skimage

from .command_line import CommandLine
from .corruptions.rain import forget, write_rain
from .shared_data import shared_folder
from .small_demo import write_small_demo

cv2.setNumThreads(1)
gc.set_threshold(20_000, 20, 20)  # a search of all modules and tests in memory takes a third of a second
os.fsync = lambda _: None  # no test needs durable files, and a small run would wait nineteen times for the disk
hypothesis.settings.register_profile("untimed", deadline=None)  # tests must not fail on a busy machine
hypothesis.settings.load_profile("untimed")


def pytest_collection_finish() -> None:
    """Exclude the modules and tests from every later search for garbage."""
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call() -> Iterator[None]:
    """Run tests in one environment, so that their child processes are forked like those of a program."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTEST_CURRENT_TEST")
        return (yield)


@pytest.fixture
def shared():
    """Find a folder of the shared data: `shared("data/kitti2015")`; skips with a reason if it is absent."""
    return shared_folder


@pytest.fixture
def robustflow(monkeypatch, capsys, tmp_path) -> CommandLine:
    """The command line in the working folder `tmp_path`."""
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capsys)


@pytest.fixture
def rain_package(tmp_path, monkeypatch) -> Iterator[Path]:
    """The working folder `tmp_path`, with a user's corruption in `rain_module` and a module that it imports."""
    write_rain(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    forget()


@pytest.fixture(scope="session")
def base(tmp_path_factory):
    """A run on two small grey frames, to which `tests.made_rows.made_run` gives other rows."""
    from robustflow.api import evaluate
    from robustflow.media.images import write_image
    from robustflow.testing import ZeroFlow

    folder = tmp_path_factory.mktemp("base")
    for index in range(2):
        write_image(folder / f"{index}.png", np.full((24, 24, 3), 40 + index, np.uint8))
    return evaluate(ZeroFlow(), "folder", folder, folder / "run", corruptions=["contrast"], severities=[1])


@pytest.fixture(scope="session")
def small_demo(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The demo pair at a ninth of its pixels: `patch.setattr(skimage, "__file__", small_demo)`."""
    return write_small_demo(tmp_path_factory.mktemp("skimage"))


@pytest.fixture(scope="module")
def demo_is_small(small_demo: str) -> Iterator[None]:
    """Let a test module measure the small demo pair: `pytestmark = pytest.mark.usefixtures("demo_is_small")`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(skimage, "__file__", small_demo)
        yield


@pytest.fixture(scope="session", autouse=True)
def real_pictures() -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Outside `with real_pictures():`, runs draw no `report.html`, and pages omit the embedded pair. A page takes
    several times as long as a small run, and the embedded pair a hundred times as long.
    """
    from robustflow import api  # imported late: the process that only distributes tests does not need it
    from robustflow.report.site import examples

    replaced = (api, "_draw_figures"), (api, "_write_report"), (examples, "embedded_slider")
    real = {(module, name): getattr(module, name) for module, name in replaced}

    @contextmanager
    def drawn() -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            for (module, name), function in real.items():
                patch.setattr(module, name, function)
            yield

    with pytest.MonkeyPatch.context() as patch:
        for module, name in replaced:
            patch.setattr(module, name, lambda *_: None)
        yield drawn
