"""Attacks on several pairs that share model calls."""

import threading
from functools import partial

import numpy as np
import pytest

from robustflow.attacks import load_attack
from robustflow.attacks.api import attack_pairs
from robustflow.attacks.problem import Pair
from robustflow.core.errors import ModelError, UsageError
from robustflow.core.rng import Rng
from robustflow.testing import check_model

torch = pytest.importorskip("torch", reason="needs the torch extra")

from ..refusals import refusal  # noqa: E402
from .small_runs import every, run  # noqa: E402
from .smooth_net import FEW, ON_SMALL_PAIRS, TRUTH, Given, random_pair, smooth_model  # noqa: E402


class Noted(Given):
    """A model that records the number of pairs in each call."""

    def __init__(self, function, batched: bool = True) -> None:
        super().__init__(function)
        self.batched_gradients = batched
        self.sizes = []

    def differentiable(self, images1, images2):
        assert images1.is_contiguous()
        self.sizes.append(len(images1))
        return super().differentiable(images1, images2)


class Batched(Noted):
    """A model that also predicts batches, which are recorded as negative numbers."""

    def predict_batch(self, frames1, frames2):
        self.sizes.append(-len(frames1))
        return [self.predict(*pair) for pair in zip(frames1, frames2, strict=True)]


def pixelwise(images1, images2):
    """Compute each pixel's flow from that pixel only, so that batches are byte-identical to single pairs."""
    return 9 * torch.tanh(3 * images1 - 2 * images2.flip(1))[:, :2]


def pairs_of(attack, model, severities=(2, 4, 5)):
    given = [
        Pair(random_pair(seed=seed), attack.budget(severity), TRUTH, None, str(seed), 0, severity)
        for seed, severity in enumerate(severities)
    ]
    return [(pair, model.predict(*pair.frames)) for pair in given]


def assert_same_as_alone(attack, model, pairs, together):
    for one, pair in zip(together, pairs, strict=True):
        other = attack_pairs(attack, model, [pair])[0]
        assert np.array_equal(one.frames, other.frames)
        assert np.array_equal(one.images, other.images, equal_nan=True)
        assert (one.trace, one.warnings) == (other.trace, other.warnings) or np.isnan(one.trace).any()
        assert (one.evaluations, one.gradients) == (other.evaluations, other.gradients)


@pytest.mark.parametrize("name", ON_SMALL_PAIRS)
def test_attacks_in_a_batch_give_the_bytes_of_single_attacks(name):
    options = FEW.get(name, {}) | ({"on": Noted(pixelwise)} if name == "transfer" else {})
    model, attack = Noted(pixelwise), load_attack(name, **options)
    pairs = pairs_of(attack, model)
    together = attack_pairs(attack, model, pairs)
    if name in ("fgsm", "bim", "pgd", "cospgd", "apgd"):  # the same number of steps for every pair
        assert set(model.sizes) == {3}
    assert_same_as_alone(attack, model, pairs, together)


@pytest.mark.parametrize("name", ["pgd", "apgd", "pcfa", "square", "worst_of"])
def test_a_network_on_the_cpu_is_never_batched_and_gives_the_bytes_of_single_attacks(name):
    model, attack = Noted(smooth_model().function, batched=False), load_attack(name, **FEW[name])
    pairs = pairs_of(attack, model)
    assert_same_as_alone(attack, model, pairs, attack_pairs(attack, model, pairs))
    assert set(model.sizes) <= {1}


def test_pairs_of_a_different_size_or_with_nan_do_not_affect_a_batch():
    def nan_if_dark(images1, images2):
        dark = images1.amax(dim=(1, 2, 3), keepdim=True) < 0.5
        return torch.where(dark, images1 * np.nan, pixelwise(images1, images2).sum(dim=1, keepdim=True))[:, :2]

    model, attack = Noted(nan_if_dark), load_attack("pgd", steps=3)
    large = Pair(random_pair(12, 9, seed=7), 4, np.zeros((12, 9, 2), np.float32), None, "large", 0, 3)
    dark = Pair((np.zeros((8, 10, 3), np.uint8),) * 2, 4, TRUTH, None, "dark", 0, 3)
    pairs = [*pairs_of(attack, model), *((pair, model.predict(*pair.frames)) for pair in (large, dark))]
    together = attack_pairs(attack, model, pairs)
    assert sorted(set(model.sizes)) == [1, 4]
    assert "gradient_not_finite" in together[-1].warnings
    assert_same_as_alone(attack, model, pairs, together)


def test_a_failing_model_or_attack_ends_a_batch():
    def failing(images1, images2):
        if images1.requires_grad and len(images1) == 3:
            raise RuntimeError("too many")
        return pixelwise(images1, images2)

    class Third:
        needs_gradients = False

        def run(self, problem, rng):
            problem.query(problem.ball.clean)
            return problem.best if problem.pair.key != "2" else 1 / 0

    before, model = threading.active_count(), Noted(failing)
    cells = "; ".join(f"sample '{number}', an attacked pair" for number in range(3))
    for attack, error, culprit in ((load_attack("fgsm"), ModelError, cells), (load_attack(Third), UsageError, "third")):
        refusal(partial(attack_pairs, attack, model, pairs_of(attack, model)), error, culprit)
    assert threading.active_count() == before


def test_an_attack_can_handle_an_error_of_the_model_in_a_batch():
    class Careful:
        def run(self, problem, rng):
            with pytest.raises(ModelError):
                problem.slope(problem.ball.clean)
            return problem.best

    gradients = []

    def failing(images1, images2):
        gradients.extend([images1] * images1.requires_grad)
        if images1.requires_grad and len(gradients) > 1:  # the first one checks the gradient before the attack
            raise RuntimeError("no gradient")
        return pixelwise(images1, images2)

    model, attack = Noted(failing), load_attack(Careful)
    for one in attack_pairs(attack, model, pairs_of(attack, model)):
        assert one.loss == one.clean_loss


def test_a_run_in_batches_has_the_rows_of_a_run_of_single_pairs(tmp_path):
    names = ["pgd:steps=3", "square:queries=4", "worst_of:fgsm+pgd:steps=2"]
    single, batched = Batched(pixelwise), Batched(pixelwise)
    one = run(tmp_path / "one", single, attacks=names, severities=3, corruptions="contrast")
    several = run(tmp_path / "several", batched, attacks=names, severities=3, corruptions="contrast", batch_size=2)
    assert every(several).equals(every(one))
    assert set(single.sizes) == {1}
    assert set(batched.sizes) == {2, -2}  # both samples share every call, for gradients and for queries


def test_training_in_batches_gives_the_bytes_of_training_without():
    model, attack = Noted(pixelwise), load_attack("universal", train="3", steps=3)
    pairs = pairs_of(attack, model, (4, 4, 4))
    assert np.array_equal(*(attack.learn(model, pairs, Rng.of(0), batch_size) for batch_size in (1, 2)))
    assert sorted(set(model.sizes)) == [1, 2]


def test_the_checker_of_models_finds_pairs_of_a_batch_that_are_mixed():
    assert check_model(Batched(pixelwise)) == "Batched"
    mixed = Batched(lambda images1, images2: (images1 - images1.mean())[:, :2])
    refusal(lambda: check_model(mixed), ModelError, "differentiable")
