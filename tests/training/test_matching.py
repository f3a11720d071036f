"""GMFlowNet's matching loss agrees with a naive loop and with ptlflow's port of the authors' code."""

from __future__ import annotations

import configparser

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.core.errors import UsageError  # noqa: E402
from robustflow.training.losses.supervised import matching_loss, true_matches  # noqa: E402

from ..refusals import refusal  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]

HEIGHT, WIDTH = 40, 56


def random_features(seed: int, pairs: int = 2):
    generator = torch.Generator().manual_seed(seed)
    image1 = torch.rand(pairs, 3, HEIGHT, WIDTH, generator=generator) * 255
    truth = torch.randn(pairs, 2, HEIGHT // 8, WIDTH // 8, generator=generator) * 9
    truth = torch.nn.functional.interpolate(truth, scale_factor=8, mode="bilinear")
    image2 = image1 + torch.randn(image1.shape, generator=generator) * 20
    scores = torch.randn(pairs, 35, 35, generator=generator) * 3
    return scores.softmax(1) * scores.softmax(2), image1, image2.clamp(0, 255), truth


@pytest.mark.parametrize("seed", range(4))
def test_matching_equals_the_authors_code(seed):
    original = pytest.importorskip("ptlflow.models.gmflownet.loss", reason="needs the ptlflow extra")
    confidence, image1, image2, truth = random_features(seed)
    settings = configparser.ConfigParser()
    settings.POS_WEIGHT = settings.NEG_WEIGHT = 1
    settings.COARSE_TYPE = "cross_entropy"
    fetched = original.backwarp(image2, truth)
    occluded = ((image1 - fetched).mean(1, keepdims=True).abs() > 20).float()
    supervision = original.compute_supervision_coarse(truth, occluded, 8)
    matches = true_matches(image1, image2, truth)
    assert 5 < int((matches >= 0).sum()) < matches.numel()
    assert torch.equal(supervision.sum(2) > 0, matches >= 0)
    assert torch.equal(supervision.argmax(2)[matches >= 0], matches[matches >= 0])
    leaf, other = (confidence.clone().requires_grad_() for _ in range(2))
    ours = matching_loss(leaf, image1, image2, truth)
    expected = original.compute_coarse_loss(other, supervision, settings)
    assert ours.item() == pytest.approx(expected.item(), rel=1e-5)
    ours.backward()
    expected.backward()
    torch.testing.assert_close(leaf.grad, other.grad, rtol=1e-4, atol=1e-9)


def test_matching_equals_the_naive_loop():
    confidence, image1, image2, truth = random_features(9, pairs=1)
    matches = true_matches(image1, image2, truth)[0]
    right, wrong = [], []
    for place in range(35):
        for other in range(35):
            sure = float(np.clip(confidence[0, place, other], 1e-6, 1 - 1e-6))
            if matches[place] == other:
                right.append(-np.log(sure))
            else:
                wrong.append(-np.log(1 - sure))
    assert right
    assert matching_loss(confidence, image1, image2, truth).item() == pytest.approx(
        np.mean(right) + np.mean(wrong), rel=1e-5
    )


def test_matching_without_a_match_is_finite_and_a_wrong_size_is_refused():
    confidence, image1, image2, truth = random_features(2)
    assert matching_loss(confidence, image1, image2, truth + 1000).isfinite()
    refusal(lambda: matching_loss(confidence[:, :30], image1, image2, truth), UsageError, "--crop")
