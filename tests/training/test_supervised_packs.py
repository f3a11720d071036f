"""Training steps of GMFlowNet, FlowFormer, FlowFormer++ and FlowDiffuser match those of their authors' code (packs
`training_*` in the shared data), and the comparison detects deliberate mistakes.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

import torch.nn.functional as F  # noqa: E402

from robustflow.models.networks import flowdiffuser  # noqa: E402
from robustflow.models.networks.blocks.correlation import WindowVolume  # noqa: E402
from robustflow.models.ptlflow.net import _with_own_context  # noqa: E402
from robustflow.training.losses.supervised import (  # noqa: E402
    matching_loss,
    sequence_loss,
    true_matches,
)
from robustflow.training.network_with_loss import loss_of_batch  # noqa: E402
from robustflow.training.optimization import one_cycle, rate_of  # noqa: E402
from robustflow.training.recipe import load_recipe, recipes_of  # noqa: E402

from ..shared_data import shared_folder  # noqa: E402
from .pack_steps import Step, TrainingPack, cases_of, gradients_of, steps  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]

METHODS = {
    "gmflownet": "gmflownet_mix",
    "flowformer": "flowformer",
    "flowformer_pp": "flowformer_pp",
    "flowdiffuser": "flowdiffuser",
}
CASES = {(name, case): stated for name in METHODS for case, stated in cases_of(name).items()}
_NUMBERS = ("image1", "image2", "flow", "valid")
EACH_CASE = pytest.mark.parametrize(("name", "case"), CASES)
EACH_STEP = pytest.mark.parametrize(
    ("name", "case", "number"),
    [(*case, number) for case, stated in CASES.items() for number in range(len(stated.get("loss", "-")))],
)
_LOSS = {"flowdiffuser": (2e-6, 1e-3)}
"""Relative tolerance of the loss in the first step and in later ones, for networks that do not use the default (1e-6,
1e-4).
"""
_NORM = {"flowdiffuser": (1e-4, 1e-3), "flowformer": (1e-4, 2e-4), "flowformer_pp": (1e-4, 1e-3)}
"""Relative tolerance of the norm of all gradients in the first step and in later ones, for networks that do not use
the default 1e-4.
"""
_GRADIENT = {"flowdiffuser": 5e-4, "flowformer": 6e-3, "flowformer_pp": 6e-3}
"""Tolerance of a gradient relative to its largest value, for networks that do not use the default 1e-3."""
_GRADIENT_NORM = {"flowdiffuser": 1e-2, "flowformer": 3e-3, "flowformer_pp": 8e-3}
"""Relative tolerance of a gradient's norm, for networks that do not use the default 1e-3."""
_FLOW = {"flowformer_pp": 2e-5}
"""Tolerance of a flow relative to its largest value, for networks that do not use the default 1e-5."""
DOUBLE = ("flowformer", "flowformer_pp")
"""Networks that amplify rounding so much that processors differ. Their steps are computed here in double precision,
where they do not; the tolerances are for the rounding in the packs, which are in single precision.
"""
ROUNDING = 2e-6
"""Parameters without any effect (biases before a norm, or biases of attention keys) have gradients whose norm is at
most this: only rounding error (1e-15 in double precision).
"""


def pack_of(name: str) -> TrainingPack:
    if name != "flowdiffuser":
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    return TrainingPack.read(shared_folder("parity", f"training_{name}"))


def first_case(name: str) -> str:
    """The case into which mistakes are planted."""
    return next(iter(pack_of(name).header["cases"]))


def stage_of(name: str, case: str):
    return load_recipe(METHODS[name], CASES[name, case].get("stage", case))


def recipe_of(name: str, case: str | None = None):
    case = case or first_case(name)
    stated = CASES[name, case]
    predictions = stated["l1"] if name != "flowdiffuser" else stated["l1"][0]
    return stage_of(name, case).changed(steps=stated["num_steps"], devices=1, iterations=len(predictions))


def network_of(name: str, case: str | None = None, **changes):
    network = pack_of(name).network(recipe_of(name, case).changed(**changes))
    for module in network.modules():
        if type(module).__name__ == "DropPath":
            module.drop_prob = 0.0
    return network


def batch_of(name: str, case: str | None = None, number: int = 0):
    return pack_of(name).batch(number, CASES[name, case or first_case(name)].get("times"))


@cache
def made(name: str, case: str) -> tuple[list[Step], dict[str, torch.Tensor]]:
    """All steps of a case, and the weights after the last one."""
    count = len(CASES[name, case]["loss"])
    network, batches = network_of(name, case), [batch_of(name, case, number) for number in range(count)]
    if name not in DOUBLE:
        made_steps = list(steps(network, recipe_of(name, case), batches.__getitem__, len(batches)))
        return made_steps, network.weights()
    batches = [replace(batch, **{key: getattr(batch, key).double() for key in _NUMBERS}) for batch in batches]
    torch.set_default_dtype(torch.float64)
    try:
        made_steps = list(steps(network.double(), recipe_of(name, case), batches.__getitem__, len(batches)))
    finally:
        torch.set_default_dtype(torch.float32)
    return made_steps, network.weights()


def loss_with(name: str, network, batch=None) -> float:
    """The loss of the first case's first step after a change in the network or the batch."""
    with torch.no_grad():
        return loss_of_batch(network, batch or batch_of(name), recipe_of(name))[0].item()


def off_by(name: str, loss: float) -> float:
    """The relative error of a loss of the first case's first step."""
    return abs(loss / CASES[name, first_case(name)]["loss"][0] - 1)


@EACH_CASE
def test_recipe_of_a_case_has_its_settings_and_rates(name, case):
    pack = pack_of(name)
    expected, recipe = pack.header["cases"][case], stage_of(name, case)
    assert (recipe.gamma, recipe.learning_rate) == (expected["gamma"], expected["lr"])
    assert (recipe.optimizer.weight_decay, recipe.optimizer.clip) == (expected["wdecay"], expected["clip"])
    if "crop" in expected:
        assert (list(recipe.crop), recipe.batch) == (expected["crop"], expected["batch"])
        assert (recipe.noise > 0) == expected["add_noise"]
    assert (recipe.frozen_norms == "batchnorm") == (expected.get("bn") == "frozen")
    schedule = pack.header["schedule"]
    length, highest = re.fullmatch(r"(\d+) steps, highest rate (\S+)", schedule["of"]).groups()
    scheduled = [
        stage
        for stage in recipes_of(METHODS[name]).values()
        if (stage.steps, stage.learning_rate) == (int(length), float(highest))
    ]
    assert scheduled
    assert scheduled[0].updates - 1 == scheduled[0].steps == schedule["rates"][-1][0]
    for update, rate in schedule["rates"]:
        assert abs(rate_of(scheduled[0], update) - rate) < 1e-9


@EACH_STEP
def test_losses_and_gradient_norms_of_a_step_equal_the_originals(name, case, number):
    expected, step = pack_of(name).header["cases"][case], made(name, case)[0][number]
    tolerance = _LOSS.get(name, (1e-6, 1e-4))[number > 0]
    assert step.loss == pytest.approx(expected["loss"][number], rel=tolerance)
    assert step.numbers["epe"] == pytest.approx(expected["epe_last"][number], rel=max(tolerance, 1e-5), abs=0)
    assert step.norm == pytest.approx(expected["grad_norm"][number], rel=_NORM.get(name, (1e-4, 1e-4))[number > 0])
    assert abs(step.rate - expected["rate"][number]) < 1e-9
    if "matching" in step.numbers:
        off = expected["loss"][number] - expected["sequence"][number]
        assert 0.01 * step.numbers["matching"] == pytest.approx(off, rel=1e-3)
    per_step = expected["l1"] if name == "flowdiffuser" else [expected["l1"]]
    if number < len(per_step):
        batch = batch_of(name, case, number)
        found = [sequence_loss([flow], batch.flow, batch.valid).item() for flow in step.flows]
        assert found == pytest.approx(per_step[number], rel=tolerance)


@EACH_CASE
def test_flows_and_gradients_of_the_first_step_equal_the_originals(name, case):
    pack = pack_of(name)
    step, expected = made(name, case)[0][0], pack.header["cases"][case]
    compared = [key for key in pack.arrays if re.fullmatch(rf"{case}/flow(_last|\d+)", key)]
    assert compared
    for key in compared:
        index, stride = (-1, 2) if key.endswith("_last") else (int(key.rpartition("flow")[2]), 4)
        off = np.abs(step.flows[index][..., ::stride, ::stride].numpy() - pack.arrays[key]).max()
        assert off <= _FLOW.get(name, 1e-5) * np.abs(pack.arrays[key]).max()
    norms = expected["gradient_norms"]
    assert {key for key, norm in norms.items() if norm} == {key for key, value in step.gradients.items() if value.any()}
    for key, norm in norms.items():
        if norm and norm > ROUNDING:
            assert step.gradients[key].norm().item() == pytest.approx(norm, rel=_GRADIENT_NORM.get(name, 1e-3)), key
    for key in [key for key in pack.arrays if key.startswith(f"{case}/gradient/")]:
        if norms[parameter := key.rpartition("/")[2]] > ROUNDING:
            off = np.abs(step.gradients[parameter].numpy() - pack.arrays[key]).max()
            assert off <= _GRADIENT.get(name, 1e-3) * np.abs(pack.arrays[key]).max(), key


@EACH_CASE
def test_weights_after_the_steps_equal_the_originals(name, case):
    pack = pack_of(name)
    expected, (_, weights) = pack.header["cases"][case], made(name, case)
    moved = sum(expected["rate"])
    for key in [key for key in pack.arrays if key.startswith(f"{case}/after/")]:
        norm = expected["gradient_norms"].get(parameter := key.rpartition("/")[2])
        if not norm or norm > ROUNDING:  # Adam turns rounding errors into full-size steps
            assert np.abs(weights[parameter].numpy() - pack.arrays[key]).mean() <= 1e-2 * moved, key


@pytest.mark.parametrize("name", METHODS)
def test_loss_over_other_pixels_is_rejected(name):
    step, gamma, batch = made(name, first_case(name))[0][0], recipe_of(name).gamma, batch_of(name)
    right = sequence_loss(step.flows, batch.flow, batch.valid, gamma)
    unlimited = sequence_loss(step.flows, batch.flow, batch.valid, gamma, max_flow=float("inf"))
    counted = ((batch.valid >= 0.5) & (batch.flow.norm(dim=1) < 400)).float().mean()
    assert unlimited / right > 1.01
    assert 1 / counted > 1.1  # the mean over valid pixels only


def test_matching_of_gmflownet_with_other_frames_or_pixels_is_rejected():
    """In frames scaled to 0..1, no pixel counts as occluded; a pixel of unknown ground truth matches itself."""
    pack, batch = pack_of("gmflownet"), batch_of("gmflownet")
    expected = pack.header["cases"][first_case("gmflownet")]
    with torch.no_grad():
        _, confidence = network_of("gmflownet").matched(batch.image1, batch.image2)
    np.testing.assert_allclose(confidence[:, ::17], pack.arrays["confidence_rows"], atol=1e-6)
    right = true_matches(batch.image1, batch.image2, batch.flow)
    assert torch.equal(right, torch.from_numpy(pack.arrays["matches"]).long())
    assert int((right >= 0).sum()) == expected["matches"]
    loss = matching_loss(confidence, batch.image1, batch.image2, batch.flow).item()
    assert 0.01 * loss == pytest.approx(expected["loss"][0] - expected["sequence"][0], rel=1e-3)
    known = torch.where(batch.valid[:, None] > 0, batch.flow, 1e4)  # a vector that leaves the frame has no match
    unscaled, scaled = (batch.image1, batch.image2), (batch.image1 / 255, batch.image2 / 255)
    for frames, truth in ((scaled, batch.flow), (unscaled, known)):
        assert int((true_matches(*frames, truth) >= 0).sum()) != expected["matches"]
        assert abs(matching_loss(confidence, *frames, truth).item() / loss - 1) > 2e-3


def test_gmflownet_with_dropped_blocks_other_norms_or_an_early_schedule_is_rejected():
    pack, recipe = pack_of("gmflownet"), recipe_of("gmflownet")
    expected, zeroed = pack.header["cases"][first_case("gmflownet")], pack.header["set_to_zero"]
    network = pack.network(recipe)
    dropping = {name.removeprefix("net.model."): module for name, module in network.named_modules()}
    assert {name: dropping[name].drop_prob for name in zeroed} == {name: rate for name, (_, rate) in zeroed.items()}
    torch.manual_seed(0)
    assert off_by("gmflownet", loss_with("gmflownet", network)) > 1e-3
    norms = "none" if recipe.frozen_norms == "batchnorm" else "batchnorm"
    assert off_by("gmflownet", loss_with("gmflownet", network_of("gmflownet", frozen_norms=norms))) > 1e-2
    assert one_cycle(0, expected["num_steps"], expected["lr"]) < 0.5 * expected["rate"][0]


def test_flowformer_with_each_pairs_own_context_or_padded_crops_is_rejected():
    pack, network = pack_of("flowformer"), network_of("flowformer")
    model = network.net.model
    model.output_stride = 32
    padded = any(side % 32 for side in pack.header["size"])
    assert (off_by("flowformer", loss_with("flowformer", network)) > 1e-3) == padded
    model.output_stride = 8
    for module in model.modules():
        if hasattr(module, "context_proj"):
            module.register_forward_pre_hook(_with_own_context)
    assert off_by("flowformer", loss_with("flowformer", network)) > 5e-6


def test_flowformer_pp_with_the_contexts_of_other_pairs_is_rejected():
    """The README states 30 to 50 % for the gradients of the context projections."""
    network = network_of("flowformer_pp")
    for module in network.modules():
        if hasattr(module, "context_proj"):
            module._forward_pre_hooks.clear()
    loss, _ = loss_of_batch(network, batch_of("flowformer_pp"), recipe_of("flowformer_pp"))
    loss.backward()
    assert off_by("flowformer_pp", loss.item()) > 1e-5
    right = made("flowformer_pp", first_case("flowformer_pp"))[0][0].gradients
    projections = {key: value for key, value in gradients_of(network).items() if "context_proj" in key}
    assert len(projections) == 12
    off = [(value - right[key]).norm() / right[key].norm() for key, value in projections.items()]
    assert max(off) > 0.3


def test_flowformer_pp_pads_frames_except_in_training():
    network, seen = network_of("flowformer_pp"), []
    network.net.model.context_encoder.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0].shape))
    height, padded = (side // 32 * 32 for side in pack_of("flowformer_pp").header["size"])
    width = padded - 24
    frames = pack_of("flowformer_pp").frames(1)[:1, :, :height, :width]
    with torch.no_grad():
        for mode in (True, False, True):
            network.train(mode)
            flow = network(frames, frames)[-1] if mode else network.net(frames, frames)
            assert flow.shape == (1, 2, height, width)
    assert [tuple(shape[2:]) for shape in seen] == [(height, width), (height, padded), (height, width)]


def _time_later(patch, network, batch):
    return replace(batch, time=batch.time + 1)


def _time_of_another_step(patch, network, batch):
    return replace(batch, time=(batch.time + 40) % 1000)


def _truth_between_corners(patch, network, batch):
    def interpolate(image, size=None, mode="nearest", align_corners=None):
        return F.interpolate(image, size, mode=mode, align_corners=align_corners and image is not batch.flow)

    patch(flowdiffuser, "F", SimpleNamespace(interpolate=interpolate))


def _truth_zeroed(patch, network, batch):
    real, counts = network.denoised, (batch.valid >= 0.5) & (batch.flow.norm(dim=1) < 400)
    patch(network, "denoised", lambda one, two, flow, *rest: real(one, two, flow * counts[:, None], *rest))


def _whole_scale(patch, network, batch):
    network.net.scale.data.fill_(1.0)


def _linear_schedule(patch, network, batch):
    betas = torch.linspace(1e-4, 0.02, 1000, dtype=torch.float64)
    network.net.alphas_cumprod.copy_(torch.cumprod(1 - betas, 0))


def _far_reach(patch, network, batch):
    patch(flowdiffuser, "_REACH", 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "mistake",
    [
        _time_later,
        _truth_between_corners,
        _truth_zeroed,
        _time_of_another_step,
        _whole_scale,
        _linear_schedule,
        _far_reach,
    ],
)
def test_flowdiffuser_from_a_different_start_is_rejected(monkeypatch, mistake):
    network, batch = network_of("flowdiffuser"), batch_of("flowdiffuser")
    wrong = loss_with("flowdiffuser", network, mistake(monkeypatch.setattr, network, batch) or batch)
    assert off_by("flowdiffuser", wrong) > 2 * _LOSS["flowdiffuser"][0]


def test_flowdiffuser_with_two_sequences_of_six_is_rejected():
    step, batch = made("flowdiffuser", first_case("flowdiffuser"))[0][0], batch_of("flowdiffuser")
    half, gamma = len(step.flows) // 2, recipe_of("flowdiffuser").gamma
    halves = [sequence_loss(part, batch.flow, batch.valid, gamma) for part in (step.flows[:half], step.flows[half:])]
    assert off_by("flowdiffuser", sum(halves).item()) > 0.1


@pytest.mark.slow
def test_flowdiffuser_with_rounding_as_a_constant_is_rejected(monkeypatch):
    constant = lambda one, two, target: WindowVolume(one, two, target.detach())  # noqa: E731
    monkeypatch.setattr(flowdiffuser, "WindowVolume", constant)
    (step,) = steps(network_of("flowdiffuser"), recipe_of("flowdiffuser"), lambda number: batch_of("flowdiffuser"), 1)
    assert off_by("flowdiffuser", step.loss) <= _LOSS["flowdiffuser"][0]
    expected = CASES["flowdiffuser", first_case("flowdiffuser")]["grad_norm"][0]
    assert abs(step.norm / expected - 1) > 10 * _NORM["flowdiffuser"][0]
