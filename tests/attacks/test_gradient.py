"""The gradient that attacks follow is that of the network that predicts: through `detach`, measured by differences."""

import threading
from dataclasses import replace

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.ball import images_of
from robustflow.attacks.gradient import check_gradient
from robustflow.attacks.problem import Pair
from robustflow.core.errors import ModelError
from robustflow.testing import TexturePairs

torch = pytest.importorskip("torch", reason="needs the torch extra")

from torch.utils.checkpoint import checkpoint  # noqa: E402

from ..refusals import refusal  # noqa: E402
from .real_pairs import crop, trained  # noqa: E402
from .smooth_net import TRUTH, random_pair  # noqa: E402


class Net(torch.nn.Module):
    """Two iterations with a function between them; both frames and the weights affect the flow."""

    def __init__(self, between) -> None:
        super().__init__()
        self.conv = torch.nn.Conv2d(6, 2, 3, padding=1)
        with torch.no_grad():
            for number, value in enumerate(self.conv.parameters()):
                value.copy_(torch.randn(value.shape, generator=torch.Generator().manual_seed(number)))
        self.between = between
        self.kept = []

    def once(self, both, flow):
        return 3 * torch.tanh(self.conv(both) + flow.flip(1))

    def forward(self, image1, image2):
        both = torch.cat([image1, image2], 1)
        return self.once(both, self.between(self, both, self.once(both, both[:, :2])))


def _in_place(net, both, flow):
    flow = flow * 1
    flow.detach_()
    return flow


def _kept(net, both, flow):
    before = net.kept[-1][0]["flow"] if net.kept else 0
    net.kept = [({"flow": flow.detach()},)]
    return flow + 0 * before


CUTS = {
    "nothing": lambda net, both, flow: flow,
    "detach": lambda net, both, flow: flow.detach(),
    "torch.detach": lambda net, both, flow: torch.detach(flow),
    "detach_": _in_place,
    "data": lambda net, both, flow: flow.data,
    "detach and clone": lambda net, both, flow: flow.clone().detach().clone().requires_grad_(),
    "weights": lambda net, both, flow: flow.detach() * net.conv.weight.data.abs().sum() / net.conv.weight.abs().sum(),
    "printed": lambda net, both, flow: flow.detach() * len(f"{flow.detach().cpu().numpy()}"[:1] + f"{flow}"[:0]),
    "kept": _kept,
    "checkpoint": lambda net, both, flow: checkpoint(lambda f: net.once(both, f.detach()), flow, use_reentrant=False),
    "reentrant": lambda net, both, flow: checkpoint(lambda f: net.once(both, f.detach()), flow, use_reentrant=True),
}
UNCUT = dict.fromkeys(CUTS, CUTS["nothing"]) | dict.fromkeys(
    ("checkpoint", "reentrant"), lambda net, both, flow: net.once(both, flow)
)


def gradient(model, pair=None):
    images = torch.from_numpy(images_of(*(pair or random_pair()))).requires_grad_()
    return torch.autograd.grad(model.differentiable(images[:1], images[1:]).sum(), images)[0]


def model_of(between, **options):
    return rf.TorchModel(Net(between), device="cpu", multiple=1, **options)


@pytest.mark.parametrize("cut", CUTS)
def test_the_gradient_through_a_cut_is_that_without_it(cut):
    expected, model = gradient(model_of(UNCUT[cut])), model_of(CUTS[cut])
    flow = model.predict(*random_pair())
    for _ in range(2):
        torch.testing.assert_close(gradient(model), expected)
    np.testing.assert_array_equal(model.predict(*random_pair()), flow)


def _written(net, both, flow):
    written = torch.zeros(flow.shape)
    written[:, :1] = flow[:, :1]
    return torch.cat([written[:, :1], flow[:, 1:]], 1)


def _kept_weights(net, both, flow):
    if not net.kept:
        net.kept = [torch.eye(2).view(2, 2, 1, 1)]
    return torch.nn.functional.conv2d(flow, net.kept[0])


SINGLE = {
    "factory": lambda net, both, flow: torch.nn.functional.conv2d(flow, torch.eye(2).view(2, 2, 1, 1)),
    "float": lambda net, both, flow: flow.float(),
    "to": lambda net, both, flow: flow.to(torch.float32),
    "type": lambda net, both, flow: flow.to(dtype=torch.zeros(1).dtype).type(torch.float32),
    "written": _written,
    "kept": _kept_weights,
}
"""Ways in which networks create float32 tensors from the flow of float64 images; none changes the flow."""


@pytest.mark.parametrize("single", SINGLE)
def test_a_network_that_creates_float32_tensors_is_evaluated_in_float64(single):
    model, plain = model_of(SINGLE[single]), model_of(CUTS["nothing"])
    model.predict(*random_pair())
    images = torch.from_numpy(images_of(*random_pair())).double()
    flow, expected = (each.in_float64.differentiable(images[:1], images[1:]) for each in (model, plain))
    torch.testing.assert_close(flow, expected, rtol=1e-12, atol=0)
    assert expected.dtype == torch.float64


def test_a_network_that_keeps_its_flow_keeps_no_graph():
    model = model_of(_kept)
    gradient(model)
    assert model.net.module.kept[0][0]["flow"].grad_fn is None


def test_a_compiled_network_has_the_whole_gradient(monkeypatch):
    compiled = torch.compile
    monkeypatch.setattr(torch, "compile", lambda net: compiled(net, backend="eager"))
    model = model_of(CUTS["detach"], compile=True)
    model.predict(*random_pair())
    torch.testing.assert_close(gradient(model), gradient(model_of(CUTS["nothing"])))


def test_detach_in_a_different_thread_is_unchanged():
    seen = []

    def between(net, both, flow):
        thread = threading.Thread(target=lambda: seen.append(flow.detach().requires_grad))
        thread.start()
        thread.join()
        return flow.detach()

    gradient(model_of(between))
    assert seen == [False]


@pytest.mark.parametrize("context", [torch.inference_mode, torch.no_grad])
def test_a_network_that_records_no_graph_is_refused(context):
    model = rf.TorchModel(Net(CUTS["nothing"]), device="cpu", multiple=1)
    model.net.forward = context()(model.net.forward)
    refusal(lambda: rf.attack(*random_pair(), model, "fgsm", 3, flow=TRUTH), ModelError, "differentiable")


def _without_grad(net, both, flow):
    with torch.no_grad():
        return net.once(both, flow)


@pytest.mark.parametrize(
    ("between", "options", "followed"),
    [
        (CUTS["detach"], {}, "whole"),
        (CUTS["detach"], {"gradient": "as-written"}, "as-written"),
        (CUTS["detach"], {"variant": "flowbench"}, "as-written"),
        (CUTS["detach"], {"variant": "flowbench", "gradient": "whole"}, "whole"),
        (_without_grad, {}, "partial"),
        (lambda net, both, flow: torch.tensor(flow.tolist()), {}, "partial"),
    ],
)
def test_a_row_says_which_gradient_was_followed(between, options, followed):
    model, pair = model_of(between), random_pair(24, 32)
    attacked = rf.attack(*pair, model, "pgd", 3, flow=np.zeros((24, 32, 2), np.float32), steps=1, starts=1, **options)
    assert attacked.gradient == followed
    assert ("gradient_partial" in attacked.warnings) == (followed != "whole")


def test_the_gradient_is_an_option_of_the_attack_and_reaches_its_parts():
    for name in ("pgd:gradient=as-written", "transfer:tiny:attack=pgd:gradient=as-written", "worst_of:pgd+square"):
        assert load_attack(name).label == name
    worst = load_attack("worst_of:pgd+square:gradient=as-written")
    assert worst.parts[0].gradient == "as-written"
    model = model_of(CUTS["detach"])
    attacked = rf.attack(*random_pair(), model, worst.label, 3, flow=TRUTH, queries=2)
    assert attacked.gradient == "as-written"
    assert rf.attack(*random_pair(), model, "square", 3, queries=2).gradient is None


WRONG = {
    "whole": lambda gradient: gradient,
    "noise": lambda gradient: np.random.default_rng(1).normal(0, gradient.std(), gradient.shape).astype(np.float32),
    "reversed": lambda gradient: -gradient,
    "zero": lambda gradient: 0 * gradient,
    "partial": lambda gradient: gradient * (np.random.default_rng(2).random(gradient.shape) < 0.1),
}
"""Verdict -> a gradient made from the true one; the partial one keeps a tenth of the values, cosine about 0.3."""


def checked(model, sample, change, monkeypatch, known=None, **options):
    """Return the verdict on a model whose gradient is changed by a function; `known` keeps answers for later calls."""
    from robustflow.attacks import problem

    real, attack, known = problem.evaluate, load_attack("pgd", **options), {} if known is None else known

    def evaluate(asked):
        key = asked.model is model, asked.loss is None, asked.whole, asked.images.tobytes()
        answer = known[key] = known[key] if key in known else real(asked)
        return answer if change is None or asked.loss is None else replace(answer, gradient=change(answer.gradient))

    with monkeypatch.context() as patched:
        patched.setattr(problem, "evaluate", evaluate)
        frames, flow, valid = sample
        made = attack.problem(model, Pair(frames, 4.0, flow, valid), model.predict(*frames))
        check_gradient(made, made.pair.stream("gradient"))
    assert made.evaluations <= 40
    return made.verdict


def gradient_of(known, whole):
    """Return the gradient among the kept answers: the whole one, or that as written."""
    (answer,) = (
        answer for (*_, followed, _), answer in known.items() if answer.gradient is not None and followed is whole
    )
    return answer.gradient.astype(np.float64).ravel()


@pytest.mark.parametrize("size", [(64, 96), (96, 128)])
@pytest.mark.parametrize("name", ["tiny", pytest.param("gmflow_refine", marks=pytest.mark.slow)])
def test_the_check_tells_true_truncated_noisy_reversed_and_zero_gradients_apart(name, size, monkeypatch):
    model = trained(name)
    for number in range(6):
        sample, known = crop(number, size), {}
        verdicts = {kind: checked(model, sample, change, monkeypatch, known) for kind, change in WRONG.items()}
        assert verdicts == {kind: kind for kind in WRONG}
        if name != "tiny":
            verdict = checked(model, sample, None, monkeypatch, known, gradient="as-written")
            whole, written = (gradient_of(known, answer) for answer in (True, False))
            # on some crops it is no more like the gradient than a random direction
            correlation = abs(np.corrcoef(whole, written)[0, 1]) * whole.size**0.5
            assert verdict == ("partial" if correlation > 8 else "noise")


def test_noise_is_not_taken_for_a_part_of_the_gradient(monkeypatch):
    model, rng, verdicts = model_of(CUTS["nothing"]), np.random.default_rng(0), []
    for seed in range(100):
        sample = random_pair(16, 16, seed), np.zeros((16, 16, 2), np.float32), np.ones((16, 16), bool)
        verdicts.append(checked(model, sample, lambda gradient: rng.normal(0, 1, gradient.shape), monkeypatch))
    assert verdicts == ["noise"] * 100


class Faint(Net):
    """A large flow that depends little on the frames."""

    def forward(self, image1, image2):
        return 30 + 3e-3 * super().forward(image1, image2)


@pytest.mark.parametrize(("change", "expected"), [(1, "whole"), (-1, "reversed")])
def test_the_gradient_of_a_large_flow_that_hardly_changes_is_measured_in_float32(change, expected, monkeypatch):
    monkeypatch.setattr(rf.TorchModel, "in_float64", None)
    model, frames = rf.TorchModel(Faint(CUTS["nothing"]), device="cpu", multiple=1), random_pair(64, 96)
    truth, mask = np.zeros((64, 96, 2), np.float32), np.ones((64, 96), bool)
    assert checked(model, (frames, truth, mask), lambda gradient: change * gradient, monkeypatch) == expected


def fifteen_lines(model, frames, truth, valid, budget=4, gradients=21):
    """Return the error of the last 8-bit pair of PGD with constant steps, as in a textbook."""
    clean, radius = torch.from_numpy(images_of(*frames)), budget / 255
    noise = 2 * torch.rand(clean.shape, generator=torch.Generator().manual_seed(0)) - 1
    images = (clean + radius * noise).clamp(0, 1)
    for _ in range(gradients):
        images.requires_grad_()
        flow = model.differentiable(images[:1], images[1:])[0].permute(1, 2, 0)
        loss = (flow - torch.from_numpy(truth)).norm(dim=2)[torch.from_numpy(valid)].mean()
        (slope,) = torch.autograd.grad(loss, images)
        change = images.detach() + 2.5 / gradients * radius * slope.sign() - clean
        images = (clean + change.clamp(-radius, radius)).clamp(0, 1)
    attacked = (images * 255).round().to(torch.uint8).permute(0, 2, 3, 1).numpy()
    return np.linalg.norm(model.predict(*attacked) - truth, axis=2)[valid].mean()


STRONG = ("bim", "pgd:starts=1", "cospgd:starts=1", "apgd:starts=1:steps=20")


@pytest.mark.parametrize("name", ["tiny", pytest.param("gmflow_refine", marks=pytest.mark.slow)])
def test_sign_attacks_are_at_most_5_percent_below_fifteen_lines_of_pgd(name, monkeypatch):
    monkeypatch.setattr("robustflow.attacks.base.check_gradient", lambda *_: None)  # tested above
    model, pairs = trained(name), [crop(number) for number in range(10)]
    reference = np.mean([fifteen_lines(model, *pair) for pair in pairs])
    for attack in STRONG:
        done = [rf.attack(*pair, model, attack, budget=4, flow=flow, valid=valid) for pair, flow, valid in pairs]
        assert max(one.gradients for one in done) <= 21
        assert np.mean([one.loss for one in done]) > 0.95 * reference, attack


TWO_FRAMES = ("arflow", "brightflow", "upflow", "flowdiffuser")
PTLFLOW = (
    "ptlflow:raft_small",
    "raft",
    "gma",
    "gmflow",
    "sea_raft_s",
    "pwcnet",
    pytest.param("irr_pwc", marks=pytest.mark.xfail(reason="rounding decides the masks of its warping", strict=True)),
    "skflow",
    "rpknet",
    "neuflow2",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*TWO_FRAMES, *PTLFLOW])
def test_the_gradient_of_a_network_with_random_weights_is_its_slope(name):
    pytest.importorskip("torch" if name in TWO_FRAMES else "ptlflow")
    sample = TexturePairs(1, (128, 128)).load("0")
    model = rf.load_model(name, device="cpu", checkpoint="random")
    attack, pair = load_attack("pgd"), Pair(sample.frames, 4.0, sample.flow, sample.valid, "0")
    problem = attack.problem(model, pair, model.predict(*sample.frames))
    check_gradient(problem, pair.stream("gradient"))
    assert problem.verdict == "whole"
