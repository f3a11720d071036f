"""PGD, APGD and Square evaluate the same pairs as the published algorithms, written out in NumPy; without PyTorch."""

import numpy as np
import pytest

from robustflow.attacks import load_attack
from robustflow.core.errors import UsageError

from ..refusals import refusal
from .numpy_problem import NumpyProblem, numpy_problem

SEEDS = range(3)


def inside(ball, change):
    """The pair with a change clipped to the ball, then to 0..1, float64."""
    radius = ball.budget / 255
    if ball.norm == "linf":
        change = np.clip(change, -radius, radius)
    else:
        change = change * min(1, radius / np.sqrt((change**2).mean()))
    return np.clip(ball.clean + change, 0, 1)


def stepped(ball, images, gradient, size):
    """The pair after a step of `size` grey levels along the sign of the gradient, or for "rms" along the gradient."""
    gradient = gradient.astype(np.float64)
    direction = np.sign(gradient) if ball.norm == "linf" else gradient / np.sqrt((gradient**2).mean())
    return inside(ball, images + size / 255 * direction - ball.clean)


def score_and_gradient(problem: NumpyProblem, images):
    loss, _, gradient = problem.loss_and_gradient(np.asarray(images, np.float32))
    sign = -1 if problem.loss.towards else 1
    return sign * loss, sign * gradient


def pgd(problem: NumpyProblem, start, sizes) -> list:
    pairs = [start]
    for size in sizes:
        pairs.append(stepped(problem.ball, pairs[-1], score_and_gradient(problem, pairs[-1])[1], size))
    return pairs


def apgd(problem: NumpyProblem, start, steps: int) -> list:
    """All pairs that APGD evaluates: algorithm 1 of Croce and Hein (2020), checkpoints as in AutoAttack's code."""
    size, until, interval = 2 * problem.ball.budget, 0, max(int(0.22 * steps), 1)
    checkpoints = []
    while (until := until + interval) <= steps:
        checkpoints.append(until)
        interval = max(interval - max(int(0.03 * steps), 1), max(int(0.06 * steps), 1))
    pairs, scores, current, before = [start], [score_and_gradient(problem, start)[0]], start, start
    best, best_at_checkpoint, halved, last_checkpoint = 0, scores[0], True, 0
    for step in range(1, steps + 1):
        gradient = score_and_gradient(problem, current)[1]
        ahead = stepped(problem.ball, current, gradient, size)
        share = 0.75 if step > 1 else 1.0
        new = current + share * (ahead - current) + (1 - share) * (current - before)
        before, current = current, inside(problem.ball, new - problem.ball.clean)
        pairs.append(current)
        scores.append(score_and_gradient(problem, current)[0])
        best = step if scores[step] > scores[best] else best
        if step in checkpoints:
            rises = sum(scores[i] > scores[i - 1] for i in range(last_checkpoint + 1, step + 1))
            few = rises <= 0.75 * (step - last_checkpoint)
            halved = few or (not halved and best_at_checkpoint >= scores[best])
            if halved:
                size, current = size / 2, pairs[best]
            best_at_checkpoint, last_checkpoint = scores[best], step
    return pairs


def assert_follows(problem: NumpyProblem, expected) -> None:
    assert len(problem.asked) == len(expected)
    for number, (found, wanted) in enumerate(zip(problem.asked, expected, strict=True)):
        assert np.abs(found - wanted).max() < 2e-5, f"evaluation {number}"


@pytest.mark.parametrize("target", ["none", "negative"])
@pytest.mark.parametrize("norm", ["linf", "rms"])
@pytest.mark.parametrize("steps", [1, 5, 8, 12])
def test_pgd_takes_falling_steps_from_each_random_start(steps, norm, target):
    attack, problem = numpy_problem("pgd", steps=steps, norm=norm, starts=2, target=target)
    reference = numpy_problem("pgd", norm=norm, target=target)[1]
    first = 6 if steps >= 8 else 48 / steps  # half of the budget of 12, or 4 / steps of it
    sizes = [first * (steps - number) / steps for number in range(steps)]
    starts = [problem.ball.random(problem.pair.stream("pgd").spawn(number)) for number in range(2)]
    images = attack.run(problem, problem.pair.stream("pgd"))
    assert_follows(problem, [pair for start in starts for pair in pgd(reference, start, sizes)])
    scores = [score_and_gradient(reference, pair)[0] for pair in problem.asked]
    assert np.array_equal(images, problem.asked[int(np.argmax(scores))])
    assert [len(curve) for curve in problem.curves] == [steps + 1] * 2
    assert attack.starts == 2


def test_attacks_make_three_random_starts_and_bim_one_clean_start():
    options = {name: (load_attack(name).steps, load_attack(name).starts) for name in ("bim", "pgd", "cospgd", "apgd")}
    assert options == {"bim": (20, 1), "pgd": (20, 3), "cospgd": (20, 3), "apgd": (100, 3)}
    assert load_attack("square").queries == 1000


def test_pgd_with_a_step_option_takes_constant_steps_from_the_clean_pair_as_bim():
    attack, problem = numpy_problem("bim:step=0.25", steps=6)
    attack.run(problem, problem.pair.stream("bim"))
    assert_follows(problem, pgd(numpy_problem("bim")[1], problem.ball.clean, [3] * 6))
    assert attack.label == "bim:steps=6:step=0.25"


@pytest.mark.parametrize(("name", "size"), [("pgd", 2.55), ("bim", 12), ("pgd:step=0.5", 6)])
def test_flowbench_takes_one_start_with_constant_steps_and_returns_the_last_pair(name, size):
    attack, problem = numpy_problem(name, steps=9, variant="flowbench")
    stream = problem.pair.stream(attack.name)
    start = problem.ball.clean if attack.name == "bim" else problem.ball.random(stream.spawn(0))
    images = attack.run(problem, problem.pair.stream(attack.name))
    assert_follows(problem, pgd(numpy_problem(name)[1], start, [size] * 9))
    assert np.array_equal(images, problem.asked[-1])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("steps", "norm", "budget"),
    [
        (1, "linf", 40),
        (6, "linf", 40),
        (6, "rms", 40),
        (40, "linf", 40),
        (40, "linf", 12),
        (120, "linf", 40),
        (95, "linf", 40),
        (167, "linf", 40),
    ],
)
def test_apgd_halves_its_step_at_the_checkpoints_of_the_paper(steps, norm, budget, seed):
    attack, problem = numpy_problem("apgd", budget=budget, steps=steps, norm=norm, starts=2, seed=seed)
    reference = numpy_problem("apgd", budget=budget, norm=norm, seed=seed)[1]
    starts = [problem.ball.random(problem.pair.stream("apgd").spawn(number)) for number in range(2)]
    images = attack.run(problem, problem.pair.stream("apgd"))
    assert_follows(problem, [pair for start in starts for pair in apgd(reference, start, steps)])
    assert np.array_equal(images, problem.best)
    assert problem.gradients == 2 * (steps + 1)


@pytest.mark.parametrize("target", ["none", "zero"])
@pytest.mark.parametrize("moved", ["both", "first", "second", "joint"])
def test_square_keeps_the_squares_that_raise_the_score(moved, target):
    attack, problem = numpy_problem("square", queries=60, moved=moved, target=target, budget=12.7)
    sign, clean = (-1 if target == "zero" else 1), np.stack(problem.pair.frames).astype(int).transpose(0, 3, 1, 2)
    rng, frames = problem.pair.stream("square"), {"first": [0], "second": [1]}.get(moved, [0, 1])

    def tried(signs):
        change = 12 * signs
        if moved == "joint":
            change = np.clip(change, -clean.min(axis=0), (255 - clean).min(axis=0))
        return np.clip(clean + change, 0, 255)

    def score(levels):
        flow = problem.model.predict(*levels.transpose(0, 2, 3, 1).astype(np.uint8))
        return sign * np.hypot(flow[..., 0], flow[..., 1]).mean(dtype=float)

    def drawn(*shape):
        return np.where(rng.bits(int(np.prod(shape))) % 2, 1, -1).reshape(shape)

    signs = np.zeros(clean.shape, int)
    signs[frames] = drawn(len(frames), 3, 1, 6)[[0] * len(frames) if moved == "joint" else slice(None)]
    best, highest, scores = tried(signs), score(tried(signs)), []
    scores.append(highest)
    for query in range(1, 60):
        halvings = sum(query * 10_000 // 60 >= limit for limit in (10, 50, 200, 500, 1000, 2000, 4000, 6000, 8000))
        side = min(max(round((0.8 / 2**halvings * 30) ** 0.5), 1), 5)
        top, left = rng.integer(0, 6 - side), rng.integer(0, 7 - side)
        moves = frames if moved == "joint" else [frames[rng.integer(0, len(frames))]]
        candidate = signs.copy()
        candidate[moves, :, top : top + side, left : left + side] = drawn(3)[:, None, None]
        scores.append(score(tried(candidate)))
        if scores[-1] > highest:
            signs, best, highest = candidate, tried(candidate), scores[-1]
    images = attack.run(problem, problem.pair.stream("square"))
    assert np.allclose(sign * np.array(problem.trace), scores, rtol=1e-6)
    assert highest > sign * np.hypot(*problem.clean_flow.transpose(2, 0, 1)).mean()
    assert np.array_equal(np.rint(images * 255), best)


def test_the_curves_of_starts_give_the_spread_and_the_gain_of_the_last_quarter():
    _, problem = numpy_problem("pgd", target="none")
    clean, images = problem.loss.of(problem.clean_flow), problem.ball.clean
    outside = images + np.float32(0.5)
    for start in ([1, 2, 1, 3, 3, 3, 4, 4], [1, 2, 3, 5, 6, 6, 9, 8]):
        problem.begin()
        for value in start:
            problem.note(images, clean + value)
    problem.begin()
    problem.begin()
    problem.note(outside, clean + 50)
    problem.note(images, clean + 7)
    assert problem.curves[1] == pytest.approx([clean + value for value in (1, 2, 3, 5, 6, 6, 9, 9)])
    assert problem.start_spread == pytest.approx(9 - 4)
    assert problem.late_gain == pytest.approx(9 - 6)  # of eight evaluations, the last two are a quarter
    assert problem.best_score == pytest.approx(clean + 9)


def test_a_start_below_the_clean_score_gains_from_the_clean_score():
    _, problem = numpy_problem("pgd")
    clean = problem.loss.of(problem.clean_flow)
    for value in (-5, -4, -4, -4, -4, -4, 1, 2):
        assert problem.late_gain is None, "for fewer than eight evaluations"
        problem.note(problem.ball.clean, clean + value)
    assert problem.late_gain == pytest.approx(2)
    assert problem.start_spread is None


@pytest.mark.parametrize(("step", "accepted"), [(2, True), (2.01, False), (0, True), (-0.01, False)])
def test_a_constant_step_is_at_most_twice_the_budget(step, accepted):
    if accepted:
        assert load_attack(f"pgd:step={step}").step == step
    else:
        refusal(lambda: load_attack(f"pgd:step={step}"), UsageError, "step")
