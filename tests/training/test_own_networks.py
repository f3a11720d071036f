"""A user's networks (`own_nets`): training, seeding, and losses that the networks define themselves."""

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

import robustflow as rf  # noqa: E402
from robustflow.core.errors import ModelError, UsageError  # noqa: E402
from robustflow.training.recipe import load_recipe, recipes_of  # noqa: E402
from robustflow.training.request import Validation  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402
from robustflow.training.trained_network import load_network  # noqa: E402

from ..refusals import refusal  # noqa: E402
from .progress import lines, weights  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]

OPTIONS = {"scaling": "-1-1", "order": "rgb", "layout": "pair"}
IMAGES = 255 * torch.rand(2, 4, 3, 128, 128, generator=torch.Generator().manual_seed(0))


def method(name: str) -> str:
    return f"tests.training.own_nets:{name}"


def network_of(name, recipe=("raft_small", "chairs"), changes=None, **options):
    recipe = load_recipe(*recipe).changed(method=method(name), **(changes or {}))
    return load_network(recipe, "random", "cpu", OPTIONS | options)


@pytest.fixture
def request_of(request_for):
    """A request that trains one of the networks."""

    def make(name, output="training", **changes):
        request = request_for(output, options=tuple(OPTIONS.items()), **changes)
        return replace(request, recipe=request.recipe.changed(method=method(name)))

    return make


def test_own_network_is_trained_and_its_checkpoint_loads(request_of):
    own = request_of("Net", frozen_norms="none")
    path = run_training(own)
    state = weights(path)
    assert state["norm.num_batches_tracked"] == own.recipe.updates == len(lines(own.output))  # in training mode
    model = rf.load_model(method("Net"), checkpoint=str(path), device="cpu", **OPTIONS)
    assert torch.equal(model.net.module.last.weight, state["last.weight"])
    run_training(replace(own, resume=True))
    resumed = weights(path)
    assert resumed.keys() == state.keys()
    assert all(torch.equal(value, state[name]) for name, value in resumed.items())


@pytest.mark.parametrize(
    ("returned", "output", "count"),
    [
        ("list in a dictionary", None, 2),
        ("dictionary", "flow", 1),
        ("pair", 0, 1),
        ("list in a tuple", 0, 2),
        ("tuple", None, 2),
    ],
)
def test_training_uses_the_output_that_a_prediction_uses(returned, output, count):
    options = {"returned": returned} | ({} if output is None else {"output": output})
    model, network = network_of("Several", **options)
    flows = network(*IMAGES)
    assert len(flows) == count
    assert torch.allclose(flows[-1], model.net(*(image / 127.5 - 1 for image in IMAGES)), atol=1e-4)


def test_a_users_network_keeps_what_it_freezes_and_its_own_batchnorm():
    assert load_recipe("raft", "chairs").devices == 2  # each part of a batch would be the features of one of the frames
    model, network = network_of("Frozen", ("raft", "chairs"))
    learning = {name for name, value in network.named_parameters() if value.requires_grad}
    assert learning == {f"net.module.{name}" for name in ("norm.weight", "norm.bias", "last.weight", "last.bias")}
    network.train()(*IMAGES)
    with torch.no_grad():
        features = model.net.module.first(torch.cat([*IMAGES]) / 127.5 - 1)
    assert torch.allclose(model.net.module.norm.running_mean, 0.1 * features.mean((0, 2, 3)), atol=1e-5)


@pytest.mark.parametrize("frozen", ["batchnorm", "all"])
def test_frozen_norms_freeze_batchnorm_of_every_dimension(frozen):
    model, network = network_of("Norms", ("raft", "things"), {"frozen_norms": frozen})
    network.train()
    assert [norm.training for norm in model.net.module.norms] == [False] * 3


@pytest.mark.parametrize(
    ("name", "error", "culprit"),
    [
        ("NanInEvaluation", ModelError, "--validate"),
        ("Cut", ModelError, "loss"),
        ("Full", ModelError, "Full"),
        ("NoEntry", ModelError, method("NoEntry")),
        ("Text", UsageError, "loss(batch)"),
        ("Complex", UsageError, "loss(batch)"),
        ("LossInAList", UsageError, "loss(batch)"),
        ("Epoch", UsageError, "Epoch"),
    ],
)
def test_a_network_that_cannot_be_trained_is_refused(request_of, chairs, name, error, culprit):
    validation = Validation("flyingchairs", chairs / "FlyingChairs_release", every=1, limit=1)
    refusal(lambda: run_training(request_of(name, steps=1, validation=validation)), error, culprit)


@pytest.mark.parametrize("kind", ["raft_small", "arflow", "upflow", "brightflow", method("Net")])
def test_seed_determines_every_random_weight(kind):
    own = ":" in kind
    known = "raft_small" if own else kind
    recipe = load_recipe(known, next(iter(recipes_of(known)))).changed(method=kind)
    options = OPTIONS if own else {}
    first, again, other = (load_network(recipe, "random", "cpu", options, seed)[1].weights() for seed in (3, 3, 4))
    drawn = [name for name, value in first.items() if value.ndim == 4]
    assert len(drawn) > (1 if own else 10)
    assert [name for name in first if not torch.equal(first[name], again[name])] == []
    assert [name for name in drawn if torch.equal(first[name], other[name])] == []


@pytest.mark.parametrize("name", ["arflow", "upflow"])
def test_random_convolutions_of_methods_without_labels_are_he_normal_with_zero_biases(name):
    _, network = load_network(load_recipe(name, "unsupervised"), "random")
    layers = [layer for layer in network.modules() if isinstance(layer, torch.nn.Conv2d)]
    drawn = torch.cat([(layer.weight * (layer.weight[0].numel() / 2) ** 0.5).flatten() for layer in layers])
    assert drawn.std().item() == pytest.approx(1, rel=0.01)
    assert (drawn.abs() < 1).float().mean().item() == pytest.approx(0.6827, rel=0.01)  # a normal distribution's share
    assert not any(layer.bias.any() for layer in layers if layer.bias is not None)


def test_random_weights_of_a_training_are_those_of_a_run():
    before = torch.get_rng_state()
    plain = rf.load_model("raft_small", checkpoint="random", device="cpu").net.model.state_dict()
    _, network = load_network(load_recipe("raft_small", "chairs"), "random")
    assert torch.equal(torch.get_rng_state(), before), "the global generator is not used"
    assert network.weights().keys() == plain.keys()
    assert all(torch.equal(plain[key], value) for key, value in network.weights().items())


def test_network_with_a_custom_loss_is_trained_with_it(request_of):
    own = request_of("WithLoss")
    run_training(own)
    assert all(entry["loss"] == pytest.approx(entry["squared"]) for entry in lines(own.output))
    assert [(entry["update"], entry["empty"]) for entry in lines(own.output)] == [(0, None), (1, None)]  # strict JSON
    _, first = load_network(own.recipe, "random", "cpu", OPTIONS)
    assert not torch.equal(first.weights()["last.weight"], weights(own.output / "last.pth")["last.weight"])
    refusal(lambda: run_training(request_of("WithLoss", "odd", crop=(124, 140))), UsageError, "--crop")
