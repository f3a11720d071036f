"""What attacks require of a model, of its gradient and of their arguments, and what they warn about."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.ball import images_of
from robustflow.attacks.gradient import check_same_flow
from robustflow.attacks.problem import Pair
from robustflow.core.errors import DataError, ModelError, UsageError
from robustflow.core.rng import Rng
from robustflow.testing import check_model

torch = pytest.importorskip("torch", reason="needs the torch extra")

from ..refusals import refusal  # noqa: E402
from .smooth_net import ON_SMALL_PAIRS, TRUTH, Given, attacked_pair, random_pair, smooth_model  # noqa: E402

REFUSED = [
    ({"name": "pdg"}, UsageError, "pdg"),
    ({"norm": "l2"}, UsageError, "l2"),
    ({"steps": 0}, UsageError, "steps"),
    ({"target": "up"}, UsageError, "up"),
    ({"name": "square", "norm": "rms"}, UsageError, "rms"),
    ({"name": "pcfa", "moved": "joint"}, UsageError, "box"),
    ({"name": "pcfa", "box": "none"}, UsageError, "none"),
    ({"reference": "truth"}, UsageError, "reference"),
    ({"name": "pgd:steps=many"}, UsageError, "steps"),
    ({"name": "pgd", "step": 2.5}, UsageError, "step"),
    ({"name": "pgd", "step": "nan"}, UsageError, "step"),
    ({"name": "bim", "variant": "flowbench", "starts": 5}, UsageError, "starts"),
    ({"name": "pgd:20"}, UsageError, "pgd:20"),
    ({"name": "pgd:steps=3:steps=4"}, UsageError, "steps"),
    ({"name": load_attack("pgd"), "steps": 3}, UsageError, "steps"),
    ({"name": "transfer:dis"}, ModelError, "dis"),
    ({"name": "transfer:tny"}, UsageError, "tny"),
    ({"name": "transfer:tiny:attack=transfer"}, UsageError, "attack"),
    ({"name": "transfer:tiny:attack=pdg"}, UsageError, "pdg"),
    ({"name": "transfer:tiny:attack=worst_of"}, UsageError, "attack"),
    ({"name": "transfer", "on": smooth_model(), "iterations": 3}, UsageError, "iterations"),
    ({"name": "worst_of:pgd+pcfa"}, UsageError, "norm"),
    ({"name": "worst_of:pgd:queries=3"}, UsageError, "queries"),
    ({"name": "worst_of:worst_of:pgd"}, UsageError, "parts"),
    ({"name": "worst_of", "parts": []}, UsageError, "parts"),
    ({"budget": 0}, UsageError, "budget"),
    ({"budget": "8"}, UsageError, "budget"),
    ({"budget": float("nan")}, UsageError, "budget"),
    ({"budget": 3, "severity": 2}, UsageError, "budget"),
    ({"name": "patch", "severity": 1}, DataError, "budget"),
    ({"name": "patch", "budget": 90}, DataError, "budget"),
    ({"flow": [[1, 2]]}, DataError, "flow"),
    ({"flow": np.zeros((3, 4, 2), np.float32)}, DataError, "flow"),
    ({"flow": np.full((8, 10, 2), np.nan, np.float32)}, DataError, "flow"),
    ({"flow": TRUTH, "valid": [[1]]}, DataError, "valid"),
    ({"flow": TRUTH, "valid": np.zeros((8, 10), bool)}, UsageError, "valid"),
    ({"valid": np.ones((8, 10), bool)}, UsageError, "valid"),
    ({"loss": "l1"}, UsageError, "l1"),
]


@pytest.mark.parametrize(("change", "error", "culprit"), REFUSED)
def test_invalid_frames_or_options_are_refused(change, error, culprit):
    refusal(lambda: rf.attack(*random_pair(), smooth_model(), **{"name": "pgd", **change}), error, culprit)


class Failing(torch.autograd.Function):
    """A copy operation whose gradient cannot be computed."""

    @staticmethod
    def forward(ctx, images):
        return images.clone()

    @staticmethod
    def backward(ctx, gradient):
        raise RuntimeError("no\nbackward")


_LEARNED = torch.nn.Parameter(torch.zeros(1))
RAISED = "sample '', an attacked pair"
NO_GRADIENT = [
    (lambda images1, images2: images1[:, :2].detach(), "differentiable"),
    (lambda images1, images2: images1[:, :2].detach() + _LEARNED, "differentiable"),
    (lambda images1, images2: images1[:, :2] if not images1.requires_grad else None, "differentiable"),
    (lambda images1, images2: images1[:, :2] if not images1.requires_grad else (1,), "differentiable"),
    (lambda images1, images2: images1[:, :2] if not images1.requires_grad else 1 / 0, RAISED),
    (lambda images1, images2: Failing.apply(images1)[:, :2], RAISED),
]


@pytest.mark.parametrize(("function", "culprit"), NO_GRADIENT)
def test_a_model_whose_gradient_cannot_be_used_is_refused(function, culprit):
    refusal(lambda: attacked_pair("pgd", Given(function)), ModelError, culprit)


def test_the_clean_pair_is_predicted_twice_to_know_whether_the_answers_differ():
    asked, answers = [], iter(range(100))

    def counted(frame1, frame2):
        asked.append(frame1)
        return np.full((*frame1.shape[:2], 2), next(answers), np.float32)

    attacked = rf.attack(*random_pair(), counted, "random_sign", 4)
    assert len(asked) == 3  # the clean pair twice, and the attacked pair
    assert attacked.warnings == ("answers_differ",)


def test_attacks_count_their_evaluations_and_those_of_the_check():
    costs = {name: attacked_pair(name)[1] for name in ON_SMALL_PAIRS}
    own = {
        "random_sign": (0, 0),
        "random_gauss": (0, 0),
        "fgsm": (1, 1),
        "bim": (5, 4),
        "pgd": (5, 4),
        "cospgd": (5, 4),
        "apgd": (13, 13),
        "pcfa": (23, 21),
        "square": (30, 0),
        "transfer": (5, 4),
        "worst_of": (33, 1),
    }
    for name, (evaluations, gradients) in own.items():
        checked = gradients > 0  # the clean flow, a gradient, and at least two steps along three directions
        assert costs[name].gradients == gradients + checked
        assert costs[name].evaluations - evaluations in (range(14, 31) if checked else [0])


@pytest.mark.parametrize("name", ["tiny", "raft_small", "ptlflow:raft_small", "arflow"])
def test_the_differentiable_flow_of_a_model_is_its_prediction(name):
    pytest.importorskip({"raft_small": "torchvision", "ptlflow:raft_small": "ptlflow"}.get(name, "torch"))
    model = rf.load_model(name, device="cpu", **({} if name == "tiny" else {"checkpoint": "random"}))
    pair = random_pair(125, 133)
    predicted = model.predict(*pair)
    images = torch.from_numpy(images_of(*pair)).requires_grad_()
    flow = model.differentiable(images[:1], images[1:])
    flow.sum().backward()
    assert np.abs(flow[0].permute(1, 2, 0).detach().numpy() - predicted).max() < 2e-3
    assert torch.isfinite(images.grad).all()
    assert all(part.any() for part in (*images.grad, images.grad[..., -1], images.grad[..., -1, :]))


class Windowed(torch.nn.Module):
    """Makes its window in the first prediction and keeps it, as many networks keep a grid of the frames' size."""

    window = None

    def forward(self, image1, image2):
        if self.window is None:
            self.window = torch.hann_window(image1.shape[3])
        return (image1 - image2)[:, :2] * self.window


def test_a_network_that_keeps_a_tensor_of_its_first_prediction_is_attacked():
    model = rf.TorchModel(Windowed(), device="cpu")
    flow = model.predict(*random_pair())
    images = torch.from_numpy(images_of(*random_pair())).requires_grad_()
    model.differentiable(images[:1], images[1:]).sum().backward()
    assert images.grad.any()
    np.testing.assert_array_equal(model.predict(*random_pair()), flow)


@pytest.mark.parametrize("name", ["pgd", "apgd", "pcfa", "square"])
def test_a_flow_that_becomes_nan_is_never_the_best_and_one_that_is_nan_is_no_gain(name):
    clean = torch.from_numpy(images_of(*random_pair())[:1])

    def nan_elsewhere(images1, images2):
        return torch.where((images1 - clean).abs() < 1e-3, images1, images1 * np.nan)[:, :2]

    functions = [
        nan_elsewhere,
        lambda images1, images2: images1[:, :2] * np.nan,
        lambda images1, images2: (images1[:, :2] + 1) * np.inf,
    ]
    for number, function in enumerate(functions):
        with warnings.catch_warnings():
            warnings.simplefilter("error" if number == 2 else "ignore")
            _, attacked = attacked_pair(name, Given(function))
        assert np.array_equal(attacked.frames, random_pair())
        assert "nothing_gained" in attacked.warnings


@pytest.mark.parametrize("options", [{}, {"flow": np.ones((8, 10, 2), np.float32)}, {"target": "zero"}])
def test_an_attack_leaves_out_the_pixels_without_a_clean_flow(options):
    usable = ~np.eye(8, 10, dtype=bool)
    model = lambda frame1, frame2: np.where(usable[..., None], frame1[..., :2] / np.float32(9), np.nan)  # noqa: E731
    attacked = rf.attack(*random_pair(), model, "square", 5, queries=99, **options)
    assert "nothing_gained" not in attacked.warnings
    goal = options.get("flow", 0 if "target" in options else attacked.clean_flow)
    for flow, loss in ((attacked.flow, attacked.loss), (attacked.clean_flow, attacked.clean_loss)):
        assert loss == pytest.approx(np.linalg.norm((flow - goal)[usable], axis=-1).mean())


def test_attack_registry_and_square_work_without_torch():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import numpy as np, robustflow as rf\n"
        "from robustflow.attacks.registry import ATTACKS\n"
        "assert [ATTACKS.get(name) for name in rf.list_attacks()]\n"
        "frame = (np.arange(40 * 48 * 3) % 251).astype(np.uint8).reshape(40, 48, 3)\n"
        "print(rf.attack(frame, frame, 'dis', 'square', 2, queries=3).linf)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "2.0\n"


class Distorted(Given):
    """A model whose `differentiable` returns a distorted flow."""

    name = "distorted"

    def __init__(self, distort) -> None:
        super().__init__(smooth_model().function)
        self.distort = distort

    def differentiable(self, images1, images2):
        return self.distort(super().differentiable(images1, images2))


DISTORTIONS = {
    "halved": lambda flow: flow / 2,
    "swapped": lambda flow: flow.flip(1),
    "backward": lambda flow: -flow,
    "shifted": lambda flow: flow.roll(3, 3),
    "nan": lambda flow: flow * np.nan,
}


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_a_differentiable_flow_that_differs_from_predict_is_refused(distortion):
    model = Distorted(DISTORTIONS[distortion])
    pair = Pair(random_pair(), 4.0, TRUTH)
    training = load_attack("universal:train=1")
    refused = [
        lambda: check_model(model),
        lambda: attacked_pair("pgd", model),
        lambda: attacked_pair("transfer", on=model),
        lambda: attacked_pair("worst_of", model),
        lambda: training.learn(model, [(pair, model.predict(*pair.frames))], Rng.of(0)),
    ]
    for call in refused if distortion == "halved" else refused[:2]:
        refusal(call, ModelError, "Distorted")
    attacked_pair("square", model)  # needs no gradient


def test_flows_that_differ_by_rounding_or_where_predict_is_nan_agree():
    flow = np.random.default_rng(0).normal(0, 3, (5, 6, 2)).astype(np.float32)
    gap = flow.copy()
    gap[0] = np.nan
    for same, other in ((flow * 1.01, flow), (flow, gap), (flow, gap * np.nan), (flow * 0 + 0.005, flow * 0)):
        check_same_flow(None, same, other, "here")
    for different, other in ((flow * 1.1, flow), (flow * 0 + 0.02, flow * 0)):
        with pytest.raises(ModelError):
            check_same_flow(None, different, other, "here")


class Noise(torch.autograd.Function):
    """Identity with a gradient of noise."""

    @staticmethod
    def forward(ctx, images):
        return images.clone()

    @staticmethod
    def backward(ctx, gradient):
        return torch.randn(gradient.shape, generator=torch.Generator().manual_seed(int(1e6 * gradient.abs().sum())))


def opposed(images):
    """The same images, with the opposite gradient."""
    return images + 2 * (images.detach() - images)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("change", "warning"), [(Noise.apply, "gradient_misleading"), (opposed, "gradient_reversed")])
def test_a_gradient_of_noise_or_of_the_wrong_sign_is_detected(change, warning, seed):
    net = smooth_model().function
    model = Given(lambda images1, images2: net(change(images1), change(images2)))
    assert warning in attacked_pair("pgd", model, seed=seed)[1].warnings


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "options",
    [{}, {"target": "negative"}, {"loss": "cosine", "reference": "clean"}, {"norm": "rms"}, {"moved": "first"}],
)
def test_a_correct_gradient_is_not_doubted(options, seed):
    for name in ("pgd", "cospgd"):
        attacked = attacked_pair(name, seed=seed, **options)[1]
        assert attacked.gradient == "whole"
        assert not any(warning.startswith("gradient") for warning in attacked.warnings)


@pytest.mark.parametrize(
    ("function", "warning"),
    [
        (lambda images1, images2: 3 * (images1 + images2).round()[:, :2] + 0 * images1[:, :2], "gradient_zero"),
        (lambda images1, images2: torch.sqrt(images1 * 0)[:, :2] + images2[:, :2], "gradient_not_finite"),
    ],
)
def test_a_gradient_that_is_zero_or_not_finite_is_detected(function, warning):
    assert warning in attacked_pair("pgd", Given(function))[1].warnings
