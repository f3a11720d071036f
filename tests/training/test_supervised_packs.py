"""Training steps of GMFlowNet, FlowFormer, FlowFormer++ and FlowDiffuser match those of their authors' code (packs
`training_*` in the shared data).
"""

import re
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")


from robustflow.training.losses.supervised import matching_loss, sequence_loss, true_matches  # noqa: E402
from robustflow.training.optimization import rate_of  # noqa: E402
from robustflow.training.recipe import load_recipe, recipes_of  # noqa: E402

from ..shared_data import shared_folder  # noqa: E402
from .pack_steps import Step, TrainingPack, cases_of, steps  # noqa: E402

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


class Tolerances(NamedTuple):
    """Relative tolerances; those of a gradient and of a flow are relative to its largest value."""

    loss: tuple[float, float] = (1e-6, 1e-4)  # in the first step and in later ones
    norm: tuple[float, float] = (1e-4, 1e-4)  # of all gradients
    gradient: float = 1e-3
    gradient_norm: float = 1e-3
    flow: float = 1e-5


TOLERANCES = {
    "gmflownet": Tolerances(),
    "flowformer": Tolerances(norm=(1e-4, 2e-4), gradient=6e-3, gradient_norm=3e-3),
    "flowformer_pp": Tolerances(norm=(1e-4, 1e-3), gradient=6e-3, gradient_norm=8e-3, flow=2e-5),
    "flowdiffuser": Tolerances((2e-6, 1e-3), (1e-4, 1e-3), gradient=5e-4, gradient_norm=1e-2),
}
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


def stage_of(name: str, case: str):
    return load_recipe(METHODS[name], CASES[name, case].get("stage", case))


def recipe_of(name: str, case: str):
    stated = CASES[name, case]
    predictions = stated["l1"] if name != "flowdiffuser" else stated["l1"][0]
    return stage_of(name, case).changed(steps=stated["num_steps"], devices=1, iterations=len(predictions))


def network_of(name: str, case: str):
    network = pack_of(name).network(recipe_of(name, case))
    for module in network.modules():
        if type(module).__name__ == "DropPath":
            module.drop_prob = 0.0
    return network


def batch_of(name: str, case: str, number: int = 0):
    return pack_of(name).batch(number, CASES[name, case].get("times"))


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
    tolerance = TOLERANCES[name].loss[number > 0]
    assert step.loss == pytest.approx(expected["loss"][number], rel=tolerance)
    assert step.numbers["epe"] == pytest.approx(expected["epe_last"][number], rel=max(tolerance, 1e-5), abs=0)
    assert step.norm == pytest.approx(expected["grad_norm"][number], rel=TOLERANCES[name].norm[number > 0])
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
        assert off <= TOLERANCES[name].flow * np.abs(pack.arrays[key]).max()
    norms = expected["gradient_norms"]
    assert {key for key, norm in norms.items() if norm} == {key for key, value in step.gradients.items() if value.any()}
    for key, norm in norms.items():
        if norm and norm > ROUNDING:
            assert step.gradients[key].norm().item() == pytest.approx(norm, rel=TOLERANCES[name].gradient_norm), key
    compared = [key for key in pack.arrays if key.startswith(f"{case}/gradient/")]
    assert compared
    for key in compared:
        if norms[parameter := key.rpartition("/")[2]] > ROUNDING:
            off = np.abs(step.gradients[parameter].numpy() - pack.arrays[key]).max()
            assert off <= TOLERANCES[name].gradient * np.abs(pack.arrays[key]).max(), key


@EACH_CASE
def test_weights_after_the_steps_equal_the_originals(name, case):
    pack = pack_of(name)
    expected, (_, weights) = pack.header["cases"][case], made(name, case)
    moved = sum(expected["rate"])
    compared = [key for key in pack.arrays if key.startswith(f"{case}/after/")]
    assert compared
    for key in compared:
        norm = expected["gradient_norms"].get(parameter := key.rpartition("/")[2])
        if not norm or norm > ROUNDING:  # Adam turns rounding errors into full-size steps
            assert np.abs(weights[parameter].numpy() - pack.arrays[key]).mean() <= 1e-2 * moved, key


def test_matches_and_drop_rates_of_gmflownet_equal_the_originals():
    pack = pack_of("gmflownet")
    case, expected = next(iter(pack.header["cases"].items()))
    batch = batch_of("gmflownet", case)
    with torch.no_grad():
        _, confidence = network_of("gmflownet", case).matched(batch.image1, batch.image2)
    np.testing.assert_allclose(confidence[:, ::17], pack.arrays["confidence_rows"], atol=1e-6)
    right = true_matches(batch.image1, batch.image2, batch.flow)
    assert torch.equal(right, torch.from_numpy(pack.arrays["matches"]).long())
    assert int((right >= 0).sum()) == expected["matches"]
    loss = matching_loss(confidence, batch.image1, batch.image2, batch.flow).item()
    assert 0.01 * loss == pytest.approx(expected["loss"][0] - expected["sequence"][0], rel=1e-3)
    dropping = dict(pack.network(recipe_of("gmflownet", case)).named_modules())
    for name, (_, rate) in pack.header["set_to_zero"].items():
        assert dropping[f"net.model.{name}"].drop_prob == rate


def test_flowformer_pp_pads_frames_except_in_training():
    pack, seen = pack_of("flowformer_pp"), []
    network = network_of("flowformer_pp", next(iter(pack.header["cases"])))
    network.net.model.context_encoder.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0].shape))
    height, padded = (side // 32 * 32 for side in pack.header["size"])
    width = padded - 24
    frames = pack.frames(1)[:1, :, :height, :width]
    with torch.no_grad():
        for mode in (True, False, True):
            network.train(mode)
            flow = network(frames, frames)[-1] if mode else network.net(frames, frames)
            assert flow.shape == (1, 2, height, width)
    assert [tuple(shape[2:]) for shape in seen] == [(height, width), (height, padded), (height, width)]
