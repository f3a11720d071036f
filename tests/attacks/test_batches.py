"""Attacks on several pairs that share model calls."""

from __future__ import annotations

import threading
from functools import partial

import numpy as np
import pytest

from robustflow.attacks import load_attack
from robustflow.attacks.api import attack_pairs
from robustflow.attacks.evaluation import in_lockstep
from robustflow.attacks.problem import Pair
from robustflow.core.errors import ModelError, UsageError
from robustflow.core.rng import Rng
from robustflow.testing import check_model

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .small_attacks import FEW, ON_SMALL_PAIRS  # noqa: E402
from .small_runs import TINY, every, run  # noqa: E402
from .smooth_net import Given, random_pair, smooth_model  # noqa: E402

TRUTH = np.zeros((8, 10, 2), np.float32)


class Noted(Given):
    """A model that records the number of pairs in each call of `differentiable`."""

    def __init__(self, function, batched: bool) -> None:
        super().__init__(function)
        self.batched_gradients = batched
        self.sizes = []

    def differentiable(self, images1, images2):
        assert images1.is_contiguous()
        self.sizes.append(len(images1))
        return super().differentiable(images1, images2)


def pixelwise(images1, images2):
    """Compute each pixel's flow from that pixel only, so that batches are byte-identical to single pairs."""
    return 9 * torch.tanh(3 * images1 - 2 * images2.flip(1))[:, :2]


def _pairs(attack, model, severities=(2, 4, 5)):
    given = [
        Pair(random_pair(seed=seed), attack.budget(severity), TRUTH, None, str(seed), 0, severity)
        for seed, severity in enumerate(severities)
    ]
    return [(pair, model.predict(*pair.frames)) for pair in given]


def _same(first, second):
    assert np.array_equal(first.frames, second.frames)
    assert np.array_equal(first.images, second.images)
    assert (first.trace, first.warnings) == (second.trace, second.warnings)
    assert (first.evaluations, first.gradients) == (second.evaluations, second.gradients)


@pytest.mark.parametrize("name", ON_SMALL_PAIRS)
def test_attacks_in_a_batch_give_the_bytes_of_single_attacks(name):
    options = FEW.get(name, {})
    if name == "transfer":
        options = options | {"on": Noted(pixelwise, True)}
    model, attack = Noted(pixelwise, True), load_attack(name, **options)
    pairs = _pairs(attack, model)

    together = attack_pairs(attack, model, pairs)
    shared = len(model.sizes)
    alone = [attack_pairs(attack, model, [pair])[0] for pair in pairs]

    for one, other in zip(together, alone, strict=True):
        _same(one, other)
    if name in ("fgsm", "bim", "pgd", "cospgd", "apgd"):  # the same number of steps for every pair
        assert set(model.sizes[:shared]) == {3}
        assert 3 * shared == len(model.sizes) - shared


@pytest.mark.parametrize("name", ["pgd", "apgd", "pcfa", "square", "worst_of"])
def test_a_network_on_the_cpu_is_never_batched_and_gives_the_bytes_of_single_attacks(name):
    model, attack = Noted(smooth_model().function, False), load_attack(name, **FEW[name])
    pairs = _pairs(attack, model)

    together = attack_pairs(attack, model, pairs)

    for one, pair in zip(together, pairs, strict=True):
        _same(one, attack_pairs(attack, model, [pair])[0])
    assert set(model.sizes) <= {1}


@pytest.mark.parametrize("name", ["fgsm", "apgd", "pcfa"])
def test_a_network_in_batches_gives_the_losses_of_single_pairs_up_to_rounding(name):
    single, batched = smooth_model(), Noted(smooth_model().function, True)
    attack = load_attack(name, **FEW.get(name, {}))
    pairs = _pairs(attack, single)

    together = attack_pairs(attack, batched, pairs)

    for one, pair in zip(together, pairs, strict=True):
        assert one.trace == pytest.approx(attack_pairs(attack, single, [pair])[0].trace, rel=2e-3)
    assert max(batched.sizes) == 3


def test_pairs_of_a_different_size_do_not_affect_a_batch():
    model, attack = Noted(pixelwise, True), load_attack("pgd", steps=3)
    pairs = _pairs(attack, model)
    large = random_pair(12, 9, seed=7)
    pairs.insert(1, (Pair(large, 4, np.zeros((12, 9, 2), np.float32), None, "large", 0, 3), model.predict(*large)))

    together = attack_pairs(attack, model, pairs)

    assert sorted(set(model.sizes)) == [1, 3]
    for one, pair in zip(together, pairs, strict=True):
        _same(one, attack_pairs(attack, model, [pair])[0])


def test_nan_in_one_pair_of_a_batch_does_not_reach_the_others():
    def nan_if_dark(images1, images2):
        dark = images1.amax(dim=(1, 2, 3), keepdim=True) < 0.5
        return torch.where(dark, images1 * np.nan, pixelwise(images1, images2).sum(dim=1, keepdim=True))[:, :2]

    model, attack = Noted(nan_if_dark, True), load_attack("pgd", steps=3)
    pairs = _pairs(attack, model)
    dark = Pair((np.zeros((8, 10, 3), np.uint8),) * 2, 4, TRUTH, None, "dark", 0, 3)
    together = attack_pairs(attack, model, [*pairs, (dark, model.predict(*dark.frames))])

    assert "gradient_not_finite" in together[-1].warnings
    for one, pair in zip(together, pairs, strict=False):
        _same(one, attack_pairs(attack, model, [pair])[0])


def test_a_failing_model_or_attack_ends_a_batch_with_one_message():
    def failing(images1, images2):
        if images1.requires_grad and len(images1) == 3:
            raise RuntimeError("too many")
        return pixelwise(images1, images2)

    class Third:
        needs_gradients = False

        def run(self, problem, rng):
            problem.query(problem.ball.clean)
            return problem.best if problem.pair.key != "2" else 1 / 0

    before, model = threading.active_count(), Noted(failing, True)
    with pytest.raises(ModelError, match=r"RuntimeError on sample '0', .*; sample '2', an attacked pair.*too many"):
        attack_pairs(load_attack("fgsm"), model, _pairs(load_attack("fgsm"), model))
    with pytest.raises(UsageError, match="attack 'third' failed: ZeroDivisionError"):
        attack_pairs(load_attack(Third), model, _pairs(load_attack(Third), model))
    assert threading.active_count() == before


def test_an_attack_can_handle_an_error_of_the_model_in_a_batch():
    class Careful:
        def run(self, problem, rng):
            try:
                problem.slope(problem.ball.clean)
            except ModelError:
                return problem.best

    gradients = []

    def failing(images1, images2):
        gradients.extend([images1] * images1.requires_grad)
        if images1.requires_grad and len(gradients) > 1:  # the first one checks the gradient before the attack
            raise RuntimeError("no gradient")
        return pixelwise(images1, images2)

    model, attack = Noted(failing, True), load_attack(Careful)

    for one in attack_pairs(attack, model, _pairs(attack, model)):
        assert one.loss == one.clean_loss


def test_functions_in_lockstep_run_one_at_a_time_in_the_callers_context():
    running = []

    def task(number):
        running.append(number)
        value = np.geterr()["divide"]
        assert running.pop() == number
        return number, value

    with np.errstate(divide="raise"):
        assert in_lockstep([partial(task, number) for number in range(5)]) == [(n, "raise") for n in range(5)]


class Textured:
    """A model for runs whose batches are byte-identical to single pairs."""

    def __init__(self) -> None:
        self.model = Noted(pixelwise, True)

    batched_gradients = True

    def predict(self, frame1, frame2):
        return self.model.predict(frame1, frame2)

    def predict_batch(self, frames1, frames2):
        self.model.sizes.append(-len(frames1))
        return [self.predict(*pair) for pair in zip(frames1, frames2, strict=True)]

    def differentiable(self, images1, images2):
        return self.model.differentiable(images1, images2)


def test_a_run_in_batches_has_the_rows_of_a_run_of_single_pairs(tmp_path):
    names = ["pgd:steps=3", "square:queries=4", "worst_of:fgsm+pgd:steps=2"]
    single, batched = Textured(), Textured()

    one = run(tmp_path / "one", single, attacks=names, severities=3, corruptions="contrast")
    several = run(tmp_path / "several", batched, attacks=names, severities=3, corruptions="contrast", batch_size=2)

    assert every(several).equals(every(one))
    assert set(single.model.sizes) == {1}
    # both samples share every call, for gradients (2) and for queries (-2)
    assert set(batched.model.sizes) == {2, -2}


def test_a_run_of_a_network_on_the_cpu_has_the_same_rows_at_any_batch_size(both, tmp_path):
    batched = run(tmp_path / "run", TINY, corruptions=["contrast", "high_light"], batch_size=4)

    assert every(batched).equals(every(both))


def test_training_in_batches_gives_the_bytes_of_training_without(tmp_path):
    model = Noted(pixelwise, True)
    attack = load_attack("universal", train="3", steps=3)
    pairs = _pairs(attack, model, (4, 4, 4))

    patterns = [attack.learn(model, pairs, Rng.of(0), batch_size) for batch_size in (1, 2)]

    assert np.array_equal(*patterns)
    assert sorted(set(model.sizes)) == [1, 2]


def test_the_checker_of_models_finds_pairs_of_a_batch_that_are_mixed():
    mixed = Textured()
    mixed.model.function = lambda images1, images2: (images1 - images1.mean())[:, :2]

    assert check_model(Textured()) == "Textured"
    with pytest.raises(ModelError, match=r"method differentiable on frames of 128x160 .* do not set batched_gradients"):
        check_model(mixed)
