"""Losses with labels agree with naive loops and with ptlflow's port of GMFlowNet, and schedules with PyTorch's."""

import configparser

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.core.errors import UsageError  # noqa: E402
from robustflow.training.losses.supervised import end_point_error, matching_loss, sequence_loss, true_matches  # noqa: E402
from robustflow.training.optimization import one_cycle  # noqa: E402

from ..refusals import refusal  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


def test_sequence_loss_equals_the_naive_loop():
    rng = np.random.default_rng(0)
    flows, truth = rng.normal(size=(3, 2, 2, 5, 6)) * 10, rng.normal(size=(2, 2, 5, 6)) * 300
    valid = rng.random((2, 5, 6))
    expected, errors = 0.0, []
    for b in range(2):
        for y in range(5):
            for x in range(6):
                counts = valid[b, y, x] >= 0.5 and np.hypot(*truth[b, :, y, x]) < 400
                if counts:
                    errors.append(np.hypot(*(flows[2, b, :, y, x] - truth[b, :, y, x])))
                    for i in range(3):
                        expected += 0.7 ** (2 - i) * np.abs(flows[i, b, :, y, x] - truth[b, :, y, x]).sum() / 120
    tensors = [torch.from_numpy(flow) for flow in flows]
    arguments = torch.from_numpy(truth), torch.from_numpy(valid)
    assert 0 < len(errors) < 60
    assert sequence_loss(tensors, *arguments, gamma=0.7).item() == pytest.approx(expected, rel=1e-6)
    assert end_point_error(tensors[-1], *arguments).item() == pytest.approx(np.mean(errors), rel=1e-6)


@pytest.mark.parametrize("flows", [[], [torch.zeros(1, 2, 3, 3)]])
def test_predictions_that_do_not_fit_are_refused(flows):
    with pytest.raises(UsageError):
        sequence_loss(flows, torch.zeros(1, 2, 4, 4), torch.ones(1, 4, 4))


def test_schedule_equals_one_cycle_of_pytorch():
    for steps, highest in ((200, 4e-4), (1000, 1e-4)):
        weight = torch.nn.Parameter(torch.zeros(1))
        optimizer = torch.optim.AdamW([weight], lr=highest)
        cycle = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, highest, steps + 100, pct_start=0.05, cycle_momentum=False, anneal_strategy="linear"
        )
        for update in range(steps + 100):
            assert one_cycle(update, steps, highest) == pytest.approx(cycle.get_last_lr()[0], rel=1e-9)
            optimizer.step()
            if update < steps + 99:
                cycle.step()


def test_shares_of_a_batch_are_normalised_separately_and_the_first_updates_the_statistics():
    from robustflow.training.trained_network import group_batchnorm

    inputs = torch.randn(6, 4, 5, 5, generator=torch.Generator().manual_seed(3)) * 3 + 1
    plain, parted = torch.nn.BatchNorm2d(4), torch.nn.Sequential(torch.nn.BatchNorm2d(4))
    group_batchnorm(parted, 2)
    expected = torch.cat([plain(inputs[:3]), torch.nn.BatchNorm2d(4)(inputs[3:])])
    assert torch.equal(parted(inputs), expected)
    assert torch.equal(parted[0].running_mean, plain.running_mean)
    assert set(parted.state_dict()) == {f"0.{name}" for name in plain.state_dict()}


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


def test_matching_without_a_match_is_finite_and_a_wrong_size_is_refused():
    confidence, image1, image2, truth = random_features(2)
    assert matching_loss(confidence, image1, image2, truth + 1000).isfinite()
    refusal(lambda: matching_loss(confidence[:, :30], image1, image2, truth), UsageError, "--crop")


def test_invalid_and_very_fast_pixels_have_no_gradient():
    flow = torch.zeros(1, 2, 2, 2, requires_grad=True)
    truth = torch.full((1, 2, 2, 2), 5.0)
    truth[0, :, 0, 0] = 300  # 424 px long
    valid = torch.tensor([[[1.0, 0.0], [1.0, 1.0]]])
    sequence_loss([flow], truth, valid).backward()
    assert flow.grad is not None
    assert (flow.grad[0, 0] != 0).tolist() == [[False, False], [True, True]]
