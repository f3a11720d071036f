"""Losses with labels agree with a naive loop, and schedules with PyTorch's."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.core.errors import UsageError  # noqa: E402
from robustflow.training.losses.supervised import end_point_error, matching_loss, sequence_loss  # noqa: E402
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
    from robustflow.training.networks import group_batchnorm

    inputs = torch.randn(6, 4, 5, 5, generator=torch.Generator().manual_seed(3)) * 3 + 1
    plain, parted = torch.nn.BatchNorm2d(4), torch.nn.Sequential(torch.nn.BatchNorm2d(4))
    group_batchnorm(parted, 2)
    expected = torch.cat([plain(inputs[:3]), torch.nn.BatchNorm2d(4)(inputs[3:])])
    assert torch.equal(parted(inputs), expected)
    assert torch.equal(parted[0].running_mean, plain.running_mean)
    assert set(parted.state_dict()) == {f"0.{name}" for name in plain.state_dict()}


def test_matching_without_a_match_is_finite_and_a_wrong_size_is_refused():
    images = torch.rand(2, 1, 3, 40, 56, generator=torch.Generator().manual_seed(2)) * 255
    far = torch.full((1, 2, 40, 56), 1e3)
    confidence = torch.full((1, 35, 35), 1 / 35)
    assert matching_loss(confidence, *images, far).isfinite()
    refusal(lambda: matching_loss(confidence[:, :30], *images, far), UsageError, "--crop")


def test_invalid_and_very_fast_pixels_have_no_gradient():
    flow = torch.zeros(1, 2, 2, 2, requires_grad=True)
    truth = torch.full((1, 2, 2, 2), 5.0)
    truth[0, :, 0, 0] = 300  # 424 px long
    valid = torch.tensor([[[1.0, 0.0], [1.0, 1.0]]])
    sequence_loss([flow], truth, valid).backward()
    assert flow.grad is not None
    assert (flow.grad[0, 0] != 0).tolist() == [[False, False], [True, True]]
