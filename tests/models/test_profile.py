"""Costs of networks match the paper's table and sums by hand, and are stored in runs."""

from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch import nn

from robustflow import load_model
from robustflow.api import evaluate
from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelRef
from robustflow.models.profile import EveryFlow, count, count_prediction, measure_prediction, network_of
from robustflow.models.tiling import TiledModel
from robustflow.report.site.content import whole_content
from robustflow.run.costs import COUNTED_SIZE, RunCost
from robustflow.run.run import Run
from robustflow.stats.published.tables import published_costs

from ..refusals import refusal

pytestmark = pytest.mark.torch


def test_counts_equal_sums_by_hand():
    class Net(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.conv = nn.Conv2d(6, 8, 3, padding=1, groups=2)
            self.norm = nn.InstanceNorm2d(8)
            self.same = nn.Sequential(self.norm)
            self.linear = nn.Linear(8, 2)
            self.unused = nn.Linear(100, 100)
            self.scale = nn.Parameter(torch.ones(5))

        def forward(self, image1, image2):
            x = self.same(self.conv(torch.cat([image1, image2], 1)))
            x.flatten(2).transpose(1, 2) @ x.flatten(2)
            return self.linear(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)

    net = Net()
    counts = count(net, 4, 5)
    pixels = 20
    modules = 8 * pixels * 3 * 9 + 2 * pixels * 8
    assert counts.thop_macs == modules + 4 * 2 * 8 * pixels  # the norm is registered at two points
    assert counts.macs == modules + pixels * 8 * pixels
    assert counts.thop_parameters == 8 * 3 * 9 + 8 + 8 * 2 + 2
    assert counts.parameters == counts.thop_parameters + 100 * 100 + 100 + 5
    assert not net.conv._forward_hooks
    assert net.training


def test_network_with_data_dependent_shapes_is_run_to_be_counted():
    class Net(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.conv = nn.Conv2d(3, 2, 1)

        def forward(self, image1, image2):
            self.kept = image1
            return self.conv(image1) if (self.kept + image2).sum().item() == 0 else image1

    assert count(Net(), 4, 5).macs == 3 * 2 * 20


def test_size_that_the_network_rejects_is_refused(caplog):
    class Net(nn.Module):
        def forward(self, image1, image2):
            return nn.functional.avg_pool2d(image1, 4) * torch.zeros(1, 3, 2, 2)

    refusal(lambda: count(Net(), 12, 12), ModelError, "12x12")
    assert not caplog.records


# the paper truncates its numbers; GMFlowNet and CRAFT must actually be executed
PAPER = {
    "RAFT": "raft",
    "GMA": "gma",
    "CSFlow": "csflow",
    "SKFlow": "skflow",
    "FlowFormer": "flowformer",
    "FlowFormer++": "flowformer_pp",
    "UPFlow": "upflow",
    "ARFlow": "arflow",
    "GMFlowNet": "gmflownet",
    "CRAFT": "craft",
}


@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("GMFlowNet", "CRAFT"))) for name in PAPER]
)
def test_counts_equal_the_cost_table_of_the_paper(method):
    name = PAPER[method]
    if name not in ("upflow", "arflow"):
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    model = load_model(name, checkpoint="random", device="cpu")
    if name == "flowformer_pp":
        model.net.model.output_stride = 8
    counts = count(model.net, *model.convention.fitted_size(*COUNTED_SIZE))
    cost = published_costs()[method]
    assert counts.thop_macs / 1e9 == pytest.approx(float(cost["flops_g"]), abs=0.1)
    assert counts.thop_parameters / 1e6 == pytest.approx(float(cost["parameters_m"]), abs=0.01)
    assert counts.macs >= 0.99 * counts.thop_macs


# operations that thop counts differently in our networks; see docs/design/profiling.md
OWN = {"BrightFlow": ("brightflow", 0.27), "SAMFlow-T": ("samflow_t", 2.98), "SAMFlow-B": ("samflow_b", 2.98)}


@pytest.mark.parametrize("method", OWN)
def test_own_networks_are_counted_with_the_flow_of_every_iteration(method):
    name, otherwise = OWN[method]
    net = network_of(load_model(name, checkpoint="random", device="cpu")).net
    counts = count(EveryFlow(net), *COUNTED_SIZE)
    cost = published_costs()[method]
    assert counts.thop_macs / 1e9 + otherwise == pytest.approx(float(cost["flops_g"]), abs=0.1)
    assert counts.thop_parameters / 1e6 == pytest.approx(float(cost["parameters_m"]), abs=0.01)
    eleven_masks = 11 * 54 * 90 * (256 * 128 * 9 + 9 * 64 * 256)
    assert counts.thop_macs - count(net, *COUNTED_SIZE).thop_macs == eleven_masks


def test_only_networks_are_counted():
    with pytest.raises(UsageError):
        network_of(load_model("dis"))
    tiled = load_model("arflow", checkpoint="random", device="cpu", tile="64x128")
    assert isinstance(tiled, TiledModel)
    assert network_of(tiled) is tiled.model
    whole, cost = count_prediction(tiled.model, 64, 128), count_prediction(tiled, 100, 200)
    assert (cost.macs, cost.thop_macs) == (4 * whole.macs, 4 * whole.thop_macs)
    assert (cost.parameters, cost.thop_parameters) == (whole.parameters, whole.thop_parameters)


def test_a_prediction_is_timed():
    model = load_model("arflow", checkpoint="random", device="cpu", size="64x64")
    measured = measure_prediction(model, 64, 64, repeat=2)
    assert measured.seconds > 0
    assert measured.peak_bytes > 2**20
    assert measured.device == "cpu"
    refusal(lambda: measure_prediction(model, 64, 64, repeat=0), UsageError, "--repeat")


@pytest.fixture
def profile(robustflow):
    return partial(robustflow, "profile")


def test_cost_is_stored_in_a_run_and_shown(profile, tmp_path):
    spec = ModelRef.parse("arflow", (("checkpoint", "random"), ("device", "cpu")))
    run = evaluate(spec, "demo", output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    content = whole_content([Run(run.path)], published=False)
    counted, (numbers,) = RunCost.read(run), content.lines.values()
    assert (counted.height, counted.width, counted.seconds) == (432, 720, None)
    assert (numbers.number("parameters", ""), numbers.number("flops", "")) == (counted.parameters_m, counted.flops_g)
    code, out, err = profile("arflow", "--size", "128x192", "--repeat", 0, "--into", run.path)
    assert code == 0, err
    assert "written to" in out
    cost = RunCost.read(run)
    model = network_of(spec.load())
    counts = count(model.net, *model.convention.fitted_size(128, 192))
    assert (cost.parameters, cost.macs, cost.thop_macs) == (counts.parameters, counts.macs, counts.thop_macs)
    assert (cost.height, cost.width, cost.seconds) == (128, 192, None)
    code, _, err = profile("upflow", "--size", "128x192", "--repeat", 0, "--into", run.path)
    assert code == 2
    assert "has a different model" in err
    assert RunCost.read(run) == cost
    assert profile("--paper", "--into", run.path)[0] == 2


@pytest.mark.parametrize("runtime", ["numpy", "torch"])
def test_profile_of_tiny_is_stored_in_a_run_of_either_runtime(profile, tmp_path, runtime):
    spec = ModelRef.parse("tiny", (("runtime", runtime),))
    run = evaluate(spec, "demo", output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    code, _, err = profile("tiny", "--size", "64x96", "--repeat", 0, "--into", run.path)
    assert code == 0, err
    assert (RunCost.read(run).height, RunCost.read(run).width) == (64, 96)


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
