"""Attacks stay within their budgets, and the same seed gives the same frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.ball import MOVED, Ball
from robustflow.attacks.result import norms_of
from robustflow.testing import TexturePairs

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .smooth_net import FEW, ON_SMALL_PAIRS, TRUTH, attacked_pair, random_pair, smooth_model  # noqa: E402


def assert_within(frames, clean, budget, norm, moved, per_frame=False):
    change = np.stack(frames).astype(np.float64) - np.stack(clean)
    parts = {"first": change[:1], "second": change[1:]}.get(moved, change)
    squares = (parts**2).mean(axis=(1, 2, 3))
    sizes = {
        "linf": np.abs(parts).max(),
        "rms": np.sqrt(squares.max() if per_frame else squares.mean()),
        "area": 100 * parts.any(axis=-1).mean(axis=(1, 2)).max(),
    }
    assert sizes[norm] <= budget * (1 + 1e-9)
    assert not change[{"first": 1, "second": 0}.get(moved, slice(0, 0))].any()
    assert moved != "joint" or np.array_equal(change[0], change[1])


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(ON_SMALL_PAIRS),
    st.sampled_from(["linf", "rms"]),
    st.sampled_from(MOVED),
    st.floats(0.4, 30),
    st.integers(0, 10**6),
)
def test_no_attack_exceeds_any_budget_and_none_that_searches_ends_below_the_clean_error(
    name, norm, moved, budget, seed
):
    options = {"norm": norm, "moved": moved} | ({"box": "clipping"} if name == "pcfa" and moved == "joint" else {})
    if norm not in load_attack(name).norms or name == "worst_of":
        del options["norm"]
    if name in ("worst_of", "square", "random_sign"):
        budget = max(budget, 1)
    pair, options = random_pair(seed=seed), {"seed": seed, "flow": TRUTH, **FEW.get(name, {}), **options}
    attacked = rf.attack(*pair, smooth_model(), name, budget=budget, **options)
    assert_within(attacked.frames, pair, budget, attacked.norm, moved)
    if name in ("bim", "pgd", "cospgd", "apgd", "pcfa", "square", "worst_of"):  # they may return the clean pair
        gain = attacked.loss - attacked.clean_loss
        assert (-gain if name == "pcfa" else gain) >= 0


@pytest.mark.parametrize("name", ON_SMALL_PAIRS)
def test_attacked_frames_are_reproducible_and_differ_between_seeds(name):
    first, again, other = (attacked_pair(name, seed=seed)[1] for seed in (1, 1, 2))
    assert np.array_equal(first.frames, again.frames)
    # apgd reaches the same corner from both starting points
    drawn = name not in ("fgsm", "bim", "pcfa", "apgd", "worst_of")
    assert np.array_equal(first.frames, other.frames) != drawn
    assert (first.linf, first.rms) == norms_of(first.frames, random_pair())[:2]
    assert 0 < getattr(first, first.norm) <= first.budget == load_attack(name).budget(4)


def test_rounding_keeps_the_pixels_that_a_share_of_the_frame_allows():
    ball = Ball(*np.full((2, 10, 100, 3), 100, np.uint8), 0.7, "area")  # 100 * (7 / 1000) is above 0.7 in floats
    change = ball.to_8_bits(ball.project(ball.clean + np.float32(50 / 255))) - 100
    assert sorted(change.ravel())[-42:] == [50] * 42  # seven pixels in each frame


@pytest.mark.parametrize("name", ["random_sign", "random_gauss"])
def test_a_control_that_changes_both_frames_alike_uses_the_whole_budget(name):
    attacked = rf.attack(*np.full((2, 20, 30, 3), 128, np.uint8), smooth_model(), name, moved="joint")
    assert np.array_equal(*attacked.frames)
    assert attacked.rms == pytest.approx(attacked.budget, rel=0.05)


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


@pytest.mark.parametrize("norm", ["linf", "rms"])
def test_a_change_of_the_frame_that_stays_clean_is_undone(norm):
    class ChangesTheSecond:
        needs_gradients = False

        def run(self, problem, rng):
            images = problem.ball.clean.copy()
            images[1] *= 0.5
            problem.score(images)
            return images

    attacked = rf.attack(*random_pair(), smooth_model(), ChangesTheSecond, moved="first", norm=norm)
    assert np.array_equal(attacked.frames, random_pair())
    assert attacked.loss == attacked.clean_loss
