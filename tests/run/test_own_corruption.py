"""Runs with a user's own corruption: resumption, edits to its source, worker processes, and records."""

import sys
from functools import partial

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import RunError, UsageError
from robustflow.testing import ZeroFlow
from tests.corruptions.rain import forget
from tests.refusals import refusal

pytestmark = pytest.mark.usefixtures("demo_is_small")


def test_edited_own_corruption_starts_a_new_run_on_the_command_line(rain_package, robustflow):
    run = ["run", "--model", "dis", "-O", "preset=ultrafast", "-s", "1", "--no-examples", "--output", "run"]
    own = ["--corruptions", "rain_module:Rain,fog+rain_module:Rain"]
    assert "rain" in robustflow.prints(*run, *own)
    result = rf.load_run("run")
    assert set(result.rows["corruption"]) == {"clean", "rain", "fog+rain"}
    assert list(result.manifest.identity.frames.corruptions) == ["rain"]

    forget()
    robustflow.prints(*run, *own)  # goes on
    (rain_package / "rain_depth.py").write_text("DEPTH = 5\n")  # a module that the corruption imports
    forget()
    assert "(rain)" in robustflow.refuses(*run, *own, code=1)

    robustflow.prints("record", "pack", "run", "-o", "mine.robustflow")
    robustflow.prints("record", "verify", "mine.robustflow")
    assert rf.load_run("mine.robustflow").means == result.means


def test_own_corruption_object_has_the_same_rows_in_worker_processes(rain_package):
    from rain_module import Rain

    runs = [
        rf.evaluate(ZeroFlow(), output=rain_package / engine, corruptions=["contrast", Rain(2)], severities=[1, 2],
                    engine=engine, workers=1)
        for engine in ("serial", "processes")
    ]  # fmt: skip
    one, two = (run.rows.filter(pl.col("corruption") == "rain").sort("severity")["frames_digest"] for run in runs)
    assert one.to_list() == two.to_list()
    assert len(set(one)) == 2
    folder = rain_package / "serial"
    changed = partial(rf.evaluate, ZeroFlow(), output=folder, corruptions=["contrast", Rain(3)], severities=[1, 2])
    assert "rain" in str(refusal(changed, RunError, folder))


def test_edited_own_corruption_without_an_output_folder_starts_a_new_run_with_a_note(rain_package):
    from rain_module import Rain

    first = rf.evaluate(ZeroFlow(), corruptions=[Rain(2)], severities=[1])
    assert rf.evaluate(ZeroFlow(), corruptions=[Rain(2)], severities=[1, 2]).path == first.path
    with pytest.warns(UserWarning, match=r"rain .*runs/"):
        other = rf.evaluate(ZeroFlow(), corruptions=[Rain(3)], severities=[1])
    assert other.path != first.path
    assert set(rf.load_run(first.path).rows["severity"]) == {0, 1, 2}


def test_a_run_is_drawn_again_only_with_the_corruption_that_the_user_names(rain_package, monkeypatch, robustflow):
    own = ["--corruptions", "rain_module:Rain"]
    robustflow.prints("run", "--model", "dis", "-s", "1", "--no-examples", "--output", "run", *own)
    forget()
    monkeypatch.setattr("robustflow.corruptions.user_corruptions._own", {})
    robustflow.refusal("report run --examples", RunError, "rain")
    assert "rain_module" not in sys.modules
    robustflow.prints("report", "run", "--examples", "--own-corruption", "rain_module:Rain")
    assert (rain_package / "run" / "examples" / "worst.jpg").is_file()


class Flicker:
    """Draws random numbers from NumPy's global generator, in `draw` or in `apply`."""

    severities = (1, 2, 3, 4, 5)

    def __init__(self, where):
        self.where = where

    def draw(self, rng, severity, shape):
        return np.random.randint(100, size=3) if self.where == "draw" else 0  # noqa: NPY002

    def apply(self, frame, state, index):
        change = state + (np.random.randint(100, size=3) if self.where == "apply" else 0)  # noqa: NPY002
        return (frame // 2 + change).astype(np.uint8)


@pytest.mark.parametrize("where", ["draw", "apply"])
@pytest.mark.parametrize("workers", [None, 2])
def test_corruption_with_frames_that_cannot_be_repeated_stops_the_run(tmp_path, where, workers):
    options = {"corruptions": [Flicker(where)], "severities": [1], "workers": workers}
    refusal(lambda: rf.evaluate(ZeroFlow(), output=tmp_path, **options), UsageError, "flicker")


def test_corruption_of_a_run_is_repeated_once_and_not_for_every_cell(tmp_path):
    class Dim(Flicker):
        calls = 0

        def apply(self, frame, state, index):
            Dim.calls += 1
            return frame // 2

    rf.evaluate(ZeroFlow(), output=tmp_path, corruptions=[Dim("")], severities=[1, 2, 3])
    assert Dim.calls == 2 * 3 + 2
