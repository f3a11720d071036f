"""A model that prints does not reach stdout, which only the results of a command do."""

import csv
import io
import json
import subprocess
import sys

import pytest

LOUD = """
import atexit, ctypes, os, subprocess
import numpy as np

C = ctypes.CDLL(None)


def shout():
    print("noise")
    os.write(1, b"noise\\n")
    C.printf(b"noise\\n")
    subprocess.run(["echo", "noise"])


shout()
atexit.register(shout)


class Model:
    def __init__(self):
        shout()

    def predict(self, first, second):
        shout()
        return np.ones((*first.shape[:2], 2), np.float32)


class Rain:
    def draw(self, rng, severity, shape):
        shout()

    def apply(self, frame, state, index):
        shout()
        return frame // 2
"""
RUN = "run -m loud:Model -c loud:Rain -s 1 --no-examples -o made"


@pytest.fixture
def stdout(tmp_path):
    """Run a command in a process with the loud model; returns its stdout."""
    (tmp_path / "loud.py").write_text(LOUD)

    def call(arguments: str) -> str:
        command = [sys.executable, "-m", "robustflow", *arguments.split()]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert "noise" not in done.stdout
        return done.stdout

    return call


@pytest.mark.parametrize("engine", ["", " --workers 2", " --timeout 60"])
def test_json_of_a_run_is_json_with_a_model_that_prints(stdout, engine):
    assert json.loads(stdout(f"{RUN} --json{engine}"))[0]["name"] == "loud:Model"


def test_results_of_later_commands_are_free_of_prints(stdout):
    assert "RCRE" in stdout(RUN)
    stdout("record pack made -o made.robustflow")
    verified = stdout("record verify made.robustflow --own-corruption loud:Rain -m loud:Model --json")
    assert json.loads(verified)[0]["ok"]
    rows = list(csv.reader(io.StringIO(stdout("report made --table epe --format csv"))))
    assert len({len(row) for row in rows}) == 1
    assert "passed" in stdout("check loud:Model")
