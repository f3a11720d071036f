"""PCFA minimises the objective of its paper, and keeps the pair that the paper's code keeps."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.attacks.pcfa import _saturated, _Search  # noqa: E402

from .numpy_problem import curved_flow, numpy_problem  # noqa: E402

EDGE = 1e-7


def search_of(**options):
    attack, problem = numpy_problem("pcfa", budget=5, **options)
    return _Search(attack, problem), problem


def pair_of(search, problem, values, options):
    """The pair and the change that the variables encode, float64."""
    clean = problem.ball.clean.astype(np.float64)
    if options.get("moved") == "joint":
        low, high = clean.min(axis=0), clean.max(axis=0)
        change = np.clip(np.clip(values[0] + high, 0, 1) - high + low, 0, 1) - low
        return np.clip(clean + values[0], 0, 1), np.stack([change, change])
    frames = values if options.get("box") == "clipping" else [(np.tanh(w) + 1 - EDGE) / (2 - 2 * EDGE) for w in values]
    frames = [np.clip(one, 0, 1) for one in frames]
    moved = {"first": [0], "second": [1]}.get(options.get("moved"), [0, 1])
    images = clean.copy()
    for place, frame in zip(moved, frames, strict=True):
        images[place] = frame
    return images, np.stack([images[place] - clean[place] for place in moved])


def objective(problem, images, change, target):
    """The mean distance to the target, plus the penalty on the mean square beyond the bound."""
    flow = curved_flow(images)[0].astype(np.float64)
    goal = -problem.clean_flow if target == "negative" else 0
    bound, weight = 5 / 255, 2500 / (5 / 255) * (1.5 if target == "negative" else 1)
    return np.linalg.norm(flow - goal, axis=-1).mean() + weight * max(0, (change**2).mean() - bound**2)


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"target": "negative"},
        {"box": "clipping"},
        {"moved": "first"},
        {"moved": "second", "box": "clipping"},
        {"moved": "joint", "box": "clipping"},
    ],
)
def test_the_objective_and_its_gradient_equal_the_papers(options, inside):
    search, problem = search_of(**options)
    assert np.abs(search._pair()[0].detach().numpy() - problem.ball.clean).max() < 1e-6
    rng = np.random.default_rng(3)
    scale = (0.01 if options.get("box") else 0.02) * (0.1 if inside else 5)
    with torch.no_grad():
        for variable in search.variables:
            variable.clamp_(-2, 2).add_(torch.from_numpy(rng.normal(0, scale, variable.shape).astype(np.float32)))
    values = [variable.detach().double().numpy() for variable in search.variables]
    images, change = pair_of(search, problem, values, options)
    found = search.objective()
    target = options.get("target", "zero")
    assert np.abs(problem.asked[-1] - images).max() < 1e-6
    assert found == pytest.approx(objective(problem, images, change, target), rel=1e-4)
    for number, value in enumerate(values):
        gradient = search.variables[number].grad.numpy()
        for at in [tuple(rng.integers(0, size) for size in value.shape) for _ in range(12)]:
            sides = []
            for step in (1e-4, -1e-4):
                moved = [one.copy() for one in values]
                moved[number][at] += step
                sides.append(objective(problem, *pair_of(search, problem, moved, options), target))
            assert gradient[at] == pytest.approx((sides[0] - sides[1]) / 2e-4, rel=0.02, abs=2e-3)


def test_stored_pair_has_the_smallest_change_until_one_is_inside_the_budget():
    search, problem = search_of(variant="original")
    bound, kept = 5 / 255, []
    steps = [(3, 9.0), (4, 1.0), (2, 9.5), (0.9, 8.0), (0.5, 8.5), (1, 7.0), (1.5, 2.0)]
    for number, (size, loss) in enumerate(steps):
        images = problem.ball.clean + np.float32(number)
        search._keep(images, size * bound, loss)
        kept.append(round(float((search.kept - problem.ball.clean).mean())))
    assert kept == [0, 0, 2, 3, 3, 5, 5]


def test_a_pair_outside_the_budget_is_projected_and_evaluated_unless_in_the_original():
    for variant, asked in (("default", 1), ("original", 0)):
        search, problem = search_of(variant=variant)
        outside = np.clip(problem.ball.clean + np.float32(0.1), 0, 1)
        search._keep(outside, 0.1, 3.0)
        search._keep(problem.ball.clean, 0.0, 3.0)
        assert len(problem.asked) == asked
        assert all(np.array_equal(images, problem.ball.project(outside)) for images in problem.asked)


def test_pcfa_returns_its_best_pair_and_the_original_variant_the_stored_pair_projected():
    attack, problem = numpy_problem("pcfa", budget=5, steps=2)
    images = attack.run(problem, problem.pair.stream("pcfa"))
    assert images is problem.best
    assert problem.best_score > -np.linalg.norm(problem.clean_flow, axis=-1).mean()
    assert problem.gradients > 10
    attack, problem = numpy_problem("pcfa", budget=5, steps=2, variant="original")
    assert problem.ball.holds(attack.run(problem, problem.pair.stream("pcfa")))


def test_values_of_black_and_white_count_as_saturated():
    clean = np.full((2, 3, 4, 5), 0.5, np.float32)
    clean[0, 0, 0, :3] = (0, 1, 254 / 255)
    assert _saturated(clean) == pytest.approx(2 / 120)
    for value in (0.5, 1.0):
        attack, problem = numpy_problem("pcfa", budget=5, steps=1)
        problem.ball.clean.flags.writeable = True
        problem.ball.clean[:] = value
        attack.run(problem, problem.pair.stream("pcfa"))
        assert ("saturated" in problem.troubles) == (value == 1)
