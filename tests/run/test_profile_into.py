"""A run stores the cost of its network, and `profile --into` adds the cost at a different frame size."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.api import evaluate
from robustflow.models import ModelSpec
from robustflow.report.site.content import whole_content
from robustflow.run.costs import read_cost
from robustflow.run.profile import count, network_of
from robustflow.run.run import Run

pytestmark = pytest.mark.torch


@pytest.fixture
def profile(robustflow):
    return partial(robustflow, "profile")


def test_cost_is_stored_in_a_run_and_shown(profile, tmp_path):
    spec = ModelSpec("arflow", (("checkpoint", "random"), ("device", "cpu")))
    run = evaluate(spec, "demo", output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    content = whole_content([Run(run.path)])
    counted, known = read_cost(run), content.cells[content.lines[0]]
    assert (counted.height, counted.width, counted.seconds) == (432, 720, None)
    assert known["parameters", ""].text == f"{counted.parameters_m:.2f}"
    assert known["flops", ""].text == f"{counted.flops_g:.1f}"
    code, out, err = profile("arflow", "--size", "128x192", "--repeat", 0, "--into", run.path)
    assert code == 0, err
    assert "written to" in out
    cost = read_cost(run)
    model = network_of(spec.load())
    counts = count(model.net, *model.convention.fitted_size(128, 192))
    assert (cost.parameters, cost.macs, cost.thop_macs) == (counts.parameters, counts.macs, counts.thop_macs)
    assert (cost.height, cost.width, cost.seconds) == (128, 192, None)
    code, _, err = profile("upflow", "--size", "128x192", "--repeat", 0, "--into", run.path)
    assert code == 2
    assert "robustflow: name: " in err
    assert read_cost(run) == cost
    assert profile("--paper", "--into", run.path)[0] == 2


@pytest.mark.parametrize("runtime", ["numpy", "torch"])
def test_profile_of_tiny_is_stored_in_a_run_of_either_runtime(profile, tmp_path, runtime):
    spec = ModelSpec("tiny", (("runtime", runtime),))
    run = evaluate(spec, "demo", output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    code, _, err = profile("tiny", "--size", "64x96", "--repeat", 0, "--into", run.path)
    assert code == 0, err
    assert (read_cost(run).height, read_cost(run).width) == (64, 96)


@pytest.mark.parametrize("model", ["dis", "robustflow.testing:ZeroFlow"])
def test_profiling_a_model_that_is_not_a_network_is_refused(profile, model, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    assert profile(model)[0] == 2


def test_profile_accepts_any_frame_size(profile):
    code, out, err = profile("raft_small", "--size", "125x130", "--iterations", 1)
    assert code == 0, err
    assert "frames of 125x130, network input 1x3x128x136" in out
    assert "one pair" in out
    code, out, err = profile("raft_small", "--size", "125x130", "--repeat", -1)
    assert (code, out) == (2, "")
    assert "--repeat" in err


def test_several_models_are_profiled_in_one_table(profile):
    code, out, err = profile("raft_small", "arflow", "--size", "128x192", "--repeat", 0)
    assert code == 0, err
    lines = [line.split() for line in out.splitlines()]
    alone = {name: profile(name, "--size", "128x192", "--repeat", 0)[1] for name in ("raft_small", "arflow")}
    for line in lines[-2:]:
        assert f"parameters   {line[1]} M" in alone[line[0]]
        assert f"MACs         {line[2]} G" in alone[line[0]]
    code, _, err = profile("raft_small", "arflow", "--into", "x")
    assert (code, err.count("\n")) == (2, 1)
