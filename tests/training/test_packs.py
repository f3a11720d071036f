"""Training steps of RAFT and SAMFlow-T agree with the original code, within the tolerances in the READMEs of the packs
`training_*` in the shared data."""

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.media.images import read_image  # noqa: E402
from robustflow.training.data.loader import Batch  # noqa: E402
from robustflow.training.losses.supervised import end_point_error  # noqa: E402
from robustflow.training.optimization import one_cycle  # noqa: E402
from robustflow.training.recipe import Recipe, load_recipe  # noqa: E402
from robustflow.training.trained_network import load_network  # noqa: E402

from ..parity.weight_rule import weights  # noqa: E402
from ..shared_data import shared_folder, shared_root  # noqa: E402
from .pack_steps import NO_PACK, TrainingPack, steps  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]


RAFT = "parity/training_raft"


def image(path: Path) -> torch.Tensor:
    return torch.from_numpy(read_image(path)).permute(2, 0, 1).float()


STAGES = {"mixed": "ood"}
"""Stages of cases with a different name."""


def _cases() -> list[str]:
    path = shared_root() / RAFT / "expected.json"
    if not path.is_file():
        return [NO_PACK]
    return [name for name, stated in json.loads(path.read_text()).items() if "loss" in stated]


@pytest.mark.parametrize("case", _cases())
def test_optimiser_steps_of_raft_equal_the_originals(shared, case):
    pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    folder = shared(RAFT)
    expected = json.loads((folder / "expected.json").read_text())[case]
    recipe = load_recipe("raft", STAGES.get(case, case))
    assert recipe.gamma == expected["gamma"]
    assert recipe.learning_rate == expected["max_lr"]
    assert recipe.optimizer.weight_decay == expected["weight_decay"]
    assert (recipe.frozen_norms == "batchnorm") == expected["freeze_bn"]
    recipe = recipe.changed(steps=expected["num_steps"], devices=1)
    torch.set_num_threads(1)
    _, network = load_network(recipe, "random")
    network.load_weights({key: torch.from_numpy(value) for key, value in weights(folder / "keys.json").items()})
    items = range(len(list(folder.glob("item*_1.png"))))
    first, second = (torch.stack([image(folder / f"item{item}_{frame}.png") for item in items]) for frame in (1, 2))
    with np.load(folder / "batch.npz") as file:
        truth, valid = (torch.from_numpy(file[key]).float() for key in ("flow", "valid"))
    batch, frozen = Batch(first, second, truth, valid, ("",) * len(items)), expected["freeze_bn"]
    for number, step in enumerate(steps(network.train(), recipe, lambda _: batch, len(expected["loss"]))):
        assert step.loss == pytest.approx(
            expected["loss"][number], rel=1e-5 if number < 2 else 2e-4 if frozen else 5e-3
        )
        assert abs(step.rate - expected["lr"][number]) < 1e-9
        if number == 0:
            assert step.norm == pytest.approx(expected["grad_norm"][0], rel=1e-4)
            error = end_point_error(step.flows[-1], truth, valid, max_flow=float("inf"))
            assert error.item() == pytest.approx(expected["epe_last"][0], rel=1e-4)
    state = network.weights()
    for key, (mean, deviation) in expected["after"].items():
        close = 1e-5 if frozen else 1e-4
        assert state[key].mean().item() == pytest.approx(mean, abs=close)
        assert state[key].std().item() == pytest.approx(deviation, abs=close)


def test_the_schedule_of_a_long_training_run_equals_the_originals(shared):
    stated = json.loads((shared(RAFT) / "expected.json").read_text())
    schedules = {name: rates for name, rates in stated.items() if name.startswith("lr_")}
    assert schedules
    for name, rates in schedules.items():
        thousands, highest = int(name.removeprefix("lr_").removesuffix("k")), max(rate for _, rate in rates)
        for step, rate in rates:
            assert abs(one_cycle(step, 1000 * thousands, highest) - rate) < 1e-9


LOSS, NORM, GRADIENT, AFTER = (2e-6, 2e-5), (1e-4, 5e-4), 5e-3, 1e-5
"""Tolerances from the pack's README: for the loss and the gradient norm, relative, in the first step and in later ones;
for a gradient, relative to its largest value; and for the final weights, absolute.
"""
NO_GRADIENT = ("k_proj.bias", ".k.bias")
"""Parameters whose true gradient is 0, because softmax cancels any value added to all scores."""


@pytest.fixture(scope="module")
def pack() -> TrainingPack:
    """The pack of SAMFlow-T."""
    pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    return TrainingPack.read(shared_folder("parity", "training_samflow_t"))


@pytest.fixture(scope="module")
def recipe(pack) -> Recipe:
    """The recipe with the settings of the pack's stage and one pair per update."""
    header, ood = pack.header, load_recipe("samflow_t", "ood")
    assert (header["lr"], header["clip"]) == (ood.learning_rate, ood.optimizer.clip)
    return ood.changed(
        steps=header["num_steps"],
        batch=1,
        accumulate=1,
        iterations=len(header["steps"][0]["l1"]),
        gamma=header["gamma"],
        optimizer={**ood.optimizer.model_dump(), "weight_decay": header["wdecay"]},
    )


def alone(batch: Batch, number: int) -> Batch:
    """One pair of a batch, because the original code uses one pair per process."""
    only = slice(number, number + 1)
    return Batch(batch.image1[only], batch.image2[only], batch.flow[only], batch.valid[only], batch.names[only])


def test_steps_of_samflow_equal_the_originals(pack, recipe):
    network, batch = pack.network(recipe), pack.batch()
    expected, found = pack.header["steps"], []
    pairs = [alone(batch, stated["item"]) for stated in expected]
    for number, step in enumerate(steps(network, recipe, pairs.__getitem__, len(expected))):
        found.append(step)
        assert step.loss == pytest.approx(expected[number]["loss"], rel=LOSS[number > 0])
        assert step.norm == pytest.approx(expected[number]["grad_norm"], rel=NORM[number > 0])
        assert step.rate == pytest.approx(expected[number]["rate"], rel=1e-9)
    first, norms = found[0], expected[0]["gradient_norms"]
    assert first.gradients.keys() == {name for name, norm in norms.items() if norm}  # None if frozen, 0 if unused
    for name, gradient in first.gradients.items():
        if not name.endswith(NO_GRADIENT):
            assert gradient.norm().item() == pytest.approx(norms[name], rel=GRADIENT), name
    np.testing.assert_allclose(first.flows[-1][..., ::2, ::2], pack.arrays["flow_last"], atol=2e-3)
    for key, wanted in pack.arrays.items():
        kind, _, name = key.partition("/")
        if kind == "gradient":
            assert np.abs(first.gradients[name].numpy() - wanted).max() <= GRADIENT * np.abs(wanted).max()
        elif kind == "after":
            np.testing.assert_allclose(network.weights()[name], wanted, atol=AFTER)
