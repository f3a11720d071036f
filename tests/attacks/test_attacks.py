"""Budgets, optima, costs and refusals of the attacks."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow as rf
from robustflow.attacks import Attack, load_attack
from robustflow.attacks.ball import MOVED, NORMS, Ball
from robustflow.attacks.images import frames_of, images_of
from robustflow.attacks.loss import LOSSES, Loss
from robustflow.attacks.registry import SHIPPED
from robustflow.attacks.result import norms_of
from robustflow.errors import DataError, ModelError, UsageError
from robustflow.random.rng import Rng
from robustflow.testing import TexturePairs

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .small_attacks import FEW, ON_SMALL_PAIRS, attacked_pair  # noqa: E402
from .smooth_net import Given, linear_model, random_pair, smooth_model  # noqa: E402


@settings(max_examples=60)
@given(
    st.sampled_from(NORMS),
    st.sampled_from(MOVED),
    st.floats(0.3, 40),
    st.integers(0, 10**6),
    st.booleans(),
)
def test_projected_frames_never_exceed_the_budget_in_8_bits(norm, moved, budget, seed, per_frame):
    ball = Ball(*random_pair(seed=seed), budget, norm, moved, per_frame)
    images = ball.project(ball.clean + np.random.default_rng(seed).normal(0, 0.3, ball.clean.shape).astype(np.float32))

    frames = frames_of(ball.to_8_bits(images))

    change = np.stack(frames).astype(np.float64) - np.stack([ball.frame1, ball.frame2])
    parts = {"first": change[:1], "second": change[1:]}.get(moved, change)
    squares = (parts**2).mean(axis=(1, 2, 3))
    rms = np.sqrt(squares.max() if per_frame else squares.mean())
    assert ball.holds(images)
    area = 100 * parts.any(axis=-1).mean(axis=(1, 2)).max()
    assert {"linf": np.abs(parts).max(), "rms": rms, "area": area}[norm] <= budget
    still = {"first": 1, "second": 0}.get(moved)
    assert still is None or not change[still].any()
    assert moved != "joint" or np.array_equal(change[0], change[1])


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(ON_SMALL_PAIRS),
    st.sampled_from(["linf", "rms"]),
    st.sampled_from(MOVED),
    st.floats(0.4, 30),
    st.integers(0, 10**6),
)
def test_no_attack_exceeds_any_budget_in_8_bits_and_none_that_searches_ends_below_the_clean_error(
    name, norm, moved, budget, seed
):
    options = {"norm": norm, "moved": moved} | ({"box": "clipping"} if name == "pcfa" and moved == "joint" else {})
    if norm not in load_attack(name).norms:
        del options["norm"]
    if name in ("worst_of", "square", "random_sign"):
        options.pop("norm", None)
        budget = max(budget, 1)
    pair = random_pair(seed=seed)

    attacked = rf.attack(
        *pair,
        smooth_model(),
        name,
        budget=budget,
        flow=np.zeros((8, 10, 2), np.float32),
        seed=seed,
        **FEW.get(name, {}),
        **options,
    )

    change = np.stack(attacked.frames).astype(int) - np.stack(pair)
    parts = {"first": change[:1], "second": change[1:]}.get(moved, change)
    size = np.abs(parts).max() if attacked.norm == "linf" else np.sqrt((parts.astype(float) ** 2).mean())
    assert size <= budget * (1 + 1e-9)
    assert not change[{"first": 1, "second": 0}.get(moved, slice(0, 0))].any()
    assert moved != "joint" or np.array_equal(*change)
    if name in ("bim", "pgd", "cospgd", "apgd", "pcfa", "square", "worst_of"):  # they search, and know the clean pair
        gain = attacked.loss - attacked.clean_loss
        assert (-gain if name == "pcfa" else gain) >= 0


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "apgd", "worst_of"])
def test_on_a_linear_model_a_larger_budget_never_lowers_the_loss(name):
    losses = [attacked_pair(name, linear_model(), severity)[1].loss for severity in range(1, 6)]

    assert losses == sorted(losses)
    assert losses[0] < losses[-1]


@pytest.mark.parametrize("severity", [1, 3, 5])
@pytest.mark.parametrize("name", ON_SMALL_PAIRS)
def test_every_attack_stays_inside_its_budget(name, severity):
    clean, attacked = attacked_pair(name, severity=severity)

    norms = dict(zip(("linf", "rms"), norms_of(attacked.frames, clean), strict=False))
    assert 0 < norms[attacked.norm] <= attacked.budget == load_attack(name).budget(severity)
    assert (attacked.linf, attacked.rms) == (norms["linf"], norms["rms"])


@pytest.mark.parametrize("name", ON_SMALL_PAIRS)
def test_the_same_seed_gives_the_same_frames_and_another_gives_others(name):
    first, again, other = (attacked_pair(name, seed=seed)[1].frames for seed in (1, 1, 2))

    assert np.array_equal(first, again)
    drawn = name not in ("fgsm", "bim", "pcfa", "apgd", "worst_of")  # apgd reaches the same corner from both starts
    assert np.array_equal(first, other) != drawn


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "apgd"])
def test_sign_attacks_on_a_linear_model_reach_the_optimum(name):
    model, clean, budget = linear_model(), random_pair(), 4
    _, attacked = attacked_pair(name, model, severity=3, **({"steps": 20} if name in ("bim", "pgd") else {}))

    levels = np.stack(clean).astype(int).transpose(0, 3, 1, 2)
    best = np.clip(levels + budget * np.sign(model.weights).astype(int), 0, 255)  # u is positive and away from 0
    assert np.array_equal(np.stack(attacked.frames).transpose(0, 3, 1, 2), best)


@pytest.mark.parametrize("name", ["bim", "apgd"])
def test_attacks_under_rms_on_a_linear_model_reach_the_optimum_of_the_sphere(name):
    model = linear_model()
    grey = np.full((2, 8, 10, 3), 128, np.uint8)  # far from 0 and 255, so that only the ball binds
    truth = np.zeros((8, 10, 2), np.float32)

    attacked = rf.attack(*grey, model, name, 4, flow=truth, norm="rms", steps=60)

    change = attacked.images - images_of(*grey)
    optimum = model.weights / np.sqrt((model.weights**2).mean()) * 5 / 255
    assert np.abs(change - optimum).max() < 1e-3 * np.abs(optimum).max()


@pytest.mark.parametrize("name", ["pgd", "cospgd", "apgd"])
def test_more_starts_never_lower_the_loss(name):
    losses = [attacked_pair(name, starts=starts)[1].float_loss for starts in (1, 2, 4)]

    assert losses == sorted(losses)


@pytest.mark.parametrize("name", ["bim", "pgd", "apgd", "square"])
def test_the_best_pair_that_was_seen_is_kept(name):
    _, attacked = attacked_pair(name)

    found = attacked.loss if attacked.float_loss is None else attacked.float_loss
    assert found == pytest.approx(max(attacked.trace), rel=1e-6)


@pytest.mark.parametrize("name", ["bim", "pgd", "cospgd", "apgd", "pcfa", "square", "worst_of"])
def test_where_every_change_helps_the_model_the_clean_pair_is_the_best(name):
    clean = torch.from_numpy(images_of(*random_pair()))

    def already_at_the_target(images1, images2):
        return ((images1 - clean[:1]).abs() + (images2 - clean[1:]).abs())[:, :2]

    pair, attacked = attacked_pair(name, Given(already_at_the_target), target="zero")

    assert np.array_equal(attacked.frames, pair)
    assert attacked.loss == attacked.clean_loss == 0
    assert "nothing_gained" in attacked.warnings


def test_an_attack_whose_gain_is_lost_in_rounding_returns_the_clean_pair():
    """The flow grows up to a change of 0.6 grey levels, and shrinks at a whole one."""
    clean = torch.from_numpy(images_of(*random_pair()))

    def ridge(images1, images2):
        up = (images1 - clean[:1]) * 255
        return (10 + torch.where(up < 0.6, up, -3 * up))[:, :2] + 0 * images2[:, :2]

    options = {"budget": 1, "flow": np.zeros((8, 10, 2), np.float32), "steps": 9}
    attacked = rf.attack(*random_pair(), Given(ridge), "bim", **options)

    assert np.array_equal(attacked.frames, random_pair())
    assert attacked.loss == attacked.float_loss == attacked.clean_loss
    assert {"nothing_gained", "rounding"} <= set(attacked.warnings)


def test_the_clean_pair_is_predicted_twice_to_know_whether_the_answers_differ():
    asked = []

    def counted(frame1, frame2):
        asked.append(frame1)
        return np.zeros((*frame1.shape[:2], 2), np.float32)

    rf.attack(*random_pair(), counted, "random_sign", 4)

    assert len(asked) == 3  # and the attacked pair


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "cospgd", "apgd", "square"])
def test_attacks_beat_random_noise_of_the_same_norm(name):
    noise = attacked_pair("random_sign")[1].loss

    assert attacked_pair(name, **({"queries": 300} if name == "square" else {}))[1].loss > noise


@pytest.mark.parametrize(("target", "steps"), [("zero", 5), ("negative", 20)])
def test_pcfa_brings_the_flow_nearer_to_its_target_than_noise_does(target, steps):
    _, attacked = attacked_pair("pcfa", target=target, steps=steps)
    _, noise = attacked_pair("random_gauss", target=target)

    assert attacked.clean_loss - attacked.loss > 10 * abs(attacked.clean_loss - noise.loss)
    goal = 0 if target == "zero" else -attacked.clean_flow
    before, after = (np.linalg.norm(flow - goal, axis=-1).mean() for flow in (attacked.clean_flow, attacked.flow))
    assert attacked.way_gone == pytest.approx((before - after) / before)


def test_attacks_count_what_they_ask_for():
    costs = {name: attacked_pair(name)[1] for name in ON_SMALL_PAIRS}

    assert {name: (one.evaluations, one.gradients) for name, one in costs.items()} == {
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


@pytest.mark.parametrize("agreeing", [False, True])
@pytest.mark.parametrize("kind", LOSSES)
def test_the_slope_of_a_loss_is_its_derivative(kind, agreeing):
    rng = np.random.default_rng(0)
    flow, reference = (rng.normal(0, 2, (5, 6, 2)).astype(np.float32) for _ in range(2))
    valid = rng.random((5, 6)) < 0.6
    loss = Loss(reference, valid, kind, agreeing=agreeing)
    weight = loss._parts(flow, True)[0] / np.maximum(loss._parts(flow, False)[0], 1e-30)
    plain = Loss(reference, valid, kind)

    value, slope = loss.slope(flow)

    numbers = np.zeros_like(slope)
    for at in np.ndindex(*flow.shape):  # the weight of CosPGD is kept constant
        step = np.zeros(flow.shape)
        step[at] = 1e-4
        ahead, behind = (plain._parts((flow + sign * step).astype(np.float64), False)[0] for sign in (1, -1))
        numbers[at] = ((ahead - behind) * weight)[valid].mean() / 2e-4
    assert value == pytest.approx((plain._parts(flow, False)[0] * weight)[valid].mean())
    assert np.abs(slope - numbers).max() < 1e-3 * np.abs(numbers).max()
    assert not slope[~valid].any()


def test_a_capped_pixel_counts_the_diagonal_and_pulls_no_more():
    flow = np.zeros((3, 4, 2), np.float32)
    flow[0, 0] = (300, 400)

    value, slope = Loss(np.zeros_like(flow), kind="capped").slope(flow)

    assert value == pytest.approx(5 / 12)
    assert not slope.any()


def test_pixels_without_truth_do_not_steer_an_attack_and_do_in_flowbench():
    pair, model = random_pair(), smooth_model()
    truth = np.zeros((8, 10, 2), np.float32)
    valid = np.zeros((8, 10), bool)
    valid[:, :5] = True
    other = truth.copy()
    other[~valid] = 50

    def frames(flow, variant):
        return rf.attack(*pair, model, "pgd", 4, flow=flow, valid=valid, steps=4, variant=variant).frames

    assert np.array_equal(frames(truth, "default"), frames(other, "default"))
    without_mask = rf.attack(*pair, model, "pgd", 4, flow=truth, steps=4, variant="flowbench").frames
    assert np.array_equal(frames(other, "flowbench"), without_mask)  # flow 0 where there is no truth, and counted


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "apgd"])
def test_without_truth_an_attack_begins_at_random_and_moves_the_flow(name):
    pair, model = random_pair(), smooth_model()

    attacked = rf.attack(*pair, model, name, 4, **FEW.get(name, {}))
    noise = rf.attack(*pair, model, "random_sign", 4)

    assert attacked.moved > noise.moved > 0
    assert "gradient_zero" not in attacked.warnings


def test_a_model_that_hides_its_gradient_is_noticed():
    def hidden(images1, images2):
        return 3 * (images1 + images2).round()[:, :2] + 0 * images1[:, :2]

    _, attacked = attacked_pair("pgd", Given(hidden))

    assert "gradient_zero" in attacked.warnings


def test_a_gradient_that_is_nan_is_noticed():
    def root(images1, images2):
        return torch.sqrt(images1 * 0)[:, :2] + images2[:, :2]

    _, attacked = attacked_pair("pgd", Given(root))

    assert "gradient_not_finite" in attacked.warnings


def test_an_attack_that_has_not_converged_says_so():
    def bowl(images1, images2):  # grows ever faster: each step adds more
        return (torch.exp(8 * images1) * torch.exp(8 * images2))[:, :2]

    grey = np.full((2, 8, 10, 3), 100, np.uint8)
    truth = np.zeros((8, 10, 2), np.float32)
    rising = rf.attack(*grey, Given(bowl), "pgd", 5, flow=truth, steps=12, variant="flowbench")
    done = rf.attack(*grey, linear_model(), "pgd", 2, flow=truth, steps=40)

    assert "still_rising" in rising.warnings
    assert "still_rising" not in done.warnings


@pytest.mark.parametrize("name", ["tiny", "raft_small", "ptlflow:raft_small", "arflow"])
def test_the_differentiable_flow_of_a_model_is_its_prediction(name):
    if name == "raft_small":
        pytest.importorskip("torchvision", reason="needs torchvision")
    if name.startswith("ptlflow"):
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    options = {} if name == "tiny" else {"checkpoint": "random"}
    model = rf.load_model(name, device="cpu", **options)
    pair = random_pair(125, 133)
    predicted = model.predict(*pair)

    images = torch.from_numpy(images_of(*pair)).requires_grad_()
    flow = model.differentiable(images[:1], images[1:])
    flow.sum().backward()

    assert np.abs(flow[0].permute(1, 2, 0).detach().numpy() - predicted).max() < 2e-3
    assert torch.isfinite(images.grad).all()
    assert images.grad[0].any()
    assert images.grad[1].any()
    assert images.grad[:, :, :, -1].any()
    assert images.grad[:, :, -1].any()


def test_a_model_without_gradients_gets_one_sentence_and_square():
    pair = random_pair(40, 48)
    dis = rf.load_model("dis")

    with pytest.raises(ModelError, match=r"^model 'dis' offers no gradient .* choose square") as refused:
        rf.attack(*pair, dis, "pgd")
    assert "\n" not in str(refused.value)
    assert rf.attack(*pair, dis, "square", 3, queries=5).linf == 4


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"name": "pdg"}, UsageError, "unknown attack 'pdg': did you mean 'pgd'"),
        ({"norm": "l2"}, UsageError, "norm of attack pgd 'l2'"),
        ({"steps": 0}, UsageError, "steps of attack pgd is a whole number from 1, not 0"),
        ({"target": "up"}, UsageError, "target of attack pgd 'up'"),
        ({"name": "square", "norm": "rms"}, UsageError, "norm of attack square 'rms'"),
        ({"name": "pcfa", "moved": "joint"}, UsageError, "box=clipping"),
        ({"reference": "truth"}, UsageError, "there is none; give the flow"),
        ({"name": "pgd:steps=many"}, UsageError, "steps of attack pgd is a whole number from 1, not 'many'"),
        ({"name": "pgd:20"}, UsageError, "attack pgd takes options, option=value, and no '20'"),
        ({"name": "transfer:dis"}, ModelError, "model 'dis' offers no gradient of its flow, which the attack apgd"),
        ({"name": "transfer:tny"}, UsageError, "unknown model 'tny'"),
        ({"name": "transfer:tiny:attack=transfer"}, UsageError, "name its model alone"),
        ({"name": "transfer:tiny:attack=pdg"}, UsageError, "unknown attack 'pdg'"),
        ({"name": "worst_of:pgd+pcfa"}, UsageError, "pgd has norm linf, pcfa has norm rms; .* attacks of one norm"),
        ({"name": "worst_of:pgd:queries=3"}, UsageError, "unknown option of the attacks in worst_of 'queries'"),
        ({"name": "worst_of:worst_of:pgd"}, UsageError, "name them: worst_of:A"),
        ({"name": "transfer:tiny:attack=worst_of"}, UsageError, "worst_of:transfer"),
        ({"budget": 0}, UsageError, "more than 0 and at most 255 grey levels"),
        ({"budget": "8"}, UsageError, "at most 255 grey levels, not '8'"),
        ({"budget": float("nan")}, UsageError, "at most 255 grey levels, not nan"),
        ({"severity": 2.5}, UsageError, "severity 2.5 does not exist"),
        ({"flow": [[1, 2]]}, DataError, r"ground truth is list; expected float32 \(8, 10, 2\)"),
        ({"flow": np.full((8, 10, 2), np.nan, np.float32)}, DataError, "NaN or infinite at pixels that are valid"),
        ({"budget": 3, "severity": 2}, UsageError, "not both"),
        ({"valid": np.ones((8, 10), bool)}, UsageError, "give the flow, too"),
        ({"flow": np.zeros((3, 4, 2), np.float32)}, DataError, r"ground truth is float32 \(3, 4, 2\)"),
        ({"flow": np.zeros((8, 10, 2), np.float32), "valid": np.zeros((8, 10), bool)}, UsageError, "no pixel as valid"),
    ],
)
def test_what_cannot_be_attacked_is_refused_in_one_line(change, error, message):
    arguments = {"name": "pgd", **change}

    with pytest.raises(error, match=message) as refused:
        rf.attack(*random_pair(), smooth_model(), **arguments)
    assert "\n" not in str(refused.value)


class Failing(torch.autograd.Function):
    """A copy whose gradient cannot be computed."""

    @staticmethod
    def forward(ctx, images):
        return images.clone()

    @staticmethod
    def backward(ctx, gradient):
        raise RuntimeError("no\nbackward")


def _out_of_memory(images1, images2):
    if images1.requires_grad:
        raise RuntimeError("out of memory\nhere")
    return images1[:, :2]


_LEARNED = torch.nn.Parameter(torch.zeros(1))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda images1, images2: images1[:, :2].detach(), "a flow without a gradient"),
        (lambda images1, images2: images1[:, :2].detach() + _LEARNED, "does not follow from the images"),
        (lambda images1, images2: images1[:, :2] if not images1.requires_grad else None, "returned NoneType"),
        (lambda images1, images2: images1[:, :2] if not images1.requires_grad else (1,), "returned tuple"),
        (_out_of_memory, "raised RuntimeError on .*in its method differentiable: out of memory"),
        (
            lambda images1, images2: Failing.apply(images1)[:, :2],
            "raised RuntimeError on .*in its method differentiable",
        ),
    ],
)
def test_a_model_whose_gradient_cannot_be_used_is_refused_in_one_line(function, message):
    with pytest.raises(ModelError, match=message) as refused:
        attacked_pair("pgd", Given(function))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["pgd", "apgd", "pcfa", "square"])
def test_a_flow_that_becomes_nan_is_never_the_best_and_one_that_is_nan_is_no_gain(name):
    clean = torch.from_numpy(images_of(*random_pair())[:1])

    def nan_elsewhere(images1, images2):
        return torch.where((images1 - clean).abs() < 1e-3, images1, images1 * np.nan)[:, :2]

    _, moved = attacked_pair(name, Given(nan_elsewhere))
    _, always = attacked_pair(name, Given(lambda images1, images2: images1[:, :2] * np.nan))

    for attacked in (moved, always):
        assert np.array_equal(attacked.frames, random_pair())
        assert "nothing_gained" in attacked.warnings


def test_the_room_and_square_need_no_torch():
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


def test_every_attack_is_documented_and_has_the_severities_of_its_norm():
    for name in SHIPPED:
        attack = load_attack(name)
        assert isinstance(attack, Attack)
        assert attack.name == name
        assert type(attack).__doc__
        budgets = [attack.budget(severity) for severity in range(1, 6)]
        assert (
            budgets
            == {
                "linf": [1, 2, 4, 8, 16],
                "rms": [0.5, 1.25, 2.5, 5, 12.5],
                "area": [0.1, 0.5, 1, 2, 5],
            }[attack.norm]
        )


def test_a_ball_moves_uphill_by_the_size_of_its_step():
    ball = Ball(*(np.full((2, 4, 5, 3), 128, np.uint8)), 10, "rms")
    gradient = Rng.of(0).normals(ball.clean.size).astype(np.float32).reshape(ball.clean.shape)

    change = ball.step(ball.clean, gradient, 3) - ball.clean

    assert ball.size_of(change) * 255 == pytest.approx(3, rel=1e-4)
    assert np.corrcoef(change.ravel(), gradient.ravel())[0, 1] > 0.9999


@pytest.mark.slow  # 200 flows of a real pair
@pytest.mark.parametrize("name", ["dis", "farneback"])
def test_square_on_a_classical_method_beats_random_noise_on_a_real_pair(shared, name):
    data = rf.load_dataset("middlebury", shared("data/middlebury"))
    sample = data.load(data.keys()[0])
    cut = (slice(60, 220), slice(60, 320))
    pair = [frame[cut] for frame in sample.frames[:2]]
    truth = {"flow": sample.flow[cut], "valid": sample.valid[cut]}

    noise = rf.attack(*pair, name, "random_sign", 4, **truth)
    attacked = rf.attack(*pair, name, "square", 4, queries=200, **truth)

    assert attacked.loss > noise.loss
    assert attacked.loss > attacked.clean_loss
    assert attacked.linf == noise.linf == 8


def test_pcfa_gives_the_same_frames_on_any_number_of_threads():
    model, sample = rf.load_model("tiny", device="cpu"), TexturePairs(2, (40, 48)).load("1")
    before, frames = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            frames.append(rf.attack(*sample.frames, model, "pcfa", flow=sample.flow, key="1", steps=1).frames)
    finally:
        torch.set_num_threads(before)

    assert np.array_equal(*frames)
