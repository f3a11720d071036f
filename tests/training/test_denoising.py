"""FlowDiffuser's training: initial noise, predictions and random draws."""

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.models.networks.blocks.correlation import WindowVolume  # noqa: E402
from robustflow.models.networks.flowdiffuser import FlowDiffuser, cosine_betas  # noqa: E402
from robustflow.training.data.loader import Batch  # noqa: E402
from robustflow.training.draws import prepared  # noqa: E402
from robustflow.training.recipe import load_recipe  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]

HEIGHT, WIDTH = 64, 96


@pytest.fixture(scope="module")
def still():
    """A network whose updates have no effect, so that its predictions equal its initial flow."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        net = FlowDiffuser()
    for parameter in net.update.flow_head.ffn2[2].parameters():
        torch.nn.init.zeros_(parameter)
    return net


@pytest.mark.parametrize("time", [0, 300, 999])
def test_denoising_starts_at_the_noised_ground_truth(still, time):
    images = torch.rand(2, 1, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(1)) * 255
    truth = torch.tensor([24.0, -16.0])[None, :, None, None].expand(1, 2, HEIGHT, WIDTH)
    noise = torch.tensor([0.7, -0.4])[None, :, None, None].expand(1, 2, HEIGHT // 8, WIDTH // 8)
    with torch.no_grad():
        flows = still.denoised_predictions(*images, truth, time, noise)
    signal = float(torch.cumprod(1 - cosine_betas(), 0)[time])
    for axis, (true, drawn, side) in enumerate(((24.0, 0.7, WIDTH // 8), (-16.0, -0.4, HEIGHT // 8))):
        sample = signal**0.5 * 0.5 * true / 8 / side + (1 - signal) ** 0.5 * drawn
        expected = 8 * 0.1 * side * max(-1.0, min(1.0, sample))
        for flow in flows:
            inner = flow[0, axis, 16:-16, 16:-16]  # the upsampling reads zeros beyond the border
            assert torch.allclose(inner, torch.tensor(expected), atol=2e-3)
    assert [tuple(flow.shape) for flow in flows] == [(1, 2, HEIGHT, WIDTH)] * 12


def test_the_window_volume_is_the_same_with_gradients_and_its_gradient_is_the_plain_ones():
    generator = torch.Generator().manual_seed(2)
    features1, features2 = torch.randn(2, 1, 8, 20, 24, generator=generator).unbind()
    target = torch.rand(1, 2, 20, 24, generator=generator) * 20
    plain = WindowVolume(features1, features2, target).levels[0]
    leaves = [features.clone().requires_grad_() for features in (features1, features2)]
    volume = WindowVolume(*leaves, target).levels[0]
    assert torch.equal(volume, plain)
    weights = torch.randn(volume.shape, generator=generator)
    (volume * weights).sum().backward()
    others = [features.clone().requires_grad_() for features in (features1, features2)]
    dense = torch.einsum("bchw,bcij->hwij", *others) / 8**0.5  # all pairs; windows are cut out below
    x, y = target[0].round().long()
    padded = torch.nn.functional.pad(dense, (8, 9, 8, 9))
    total = sum(
        (padded[row, column, y[row, column] : y[row, column] + 17, x[row, column] : x[row, column] + 17]
         * weights[row * 24 + column, 0]).sum()
        for row in range(20)
        for column in range(24)
    )  # fmt: skip
    total.backward()
    for leaf, other in zip(leaves, others, strict=True):
        torch.testing.assert_close(leaf.grad, other.grad, rtol=1e-4, atol=1e-4)


def test_time_is_shared_by_a_step_and_noise_depends_on_the_position():
    recipe = load_recipe("flowdiffuser", "ood")

    def batch(pairs: int) -> Batch:
        zeros = torch.zeros(pairs, 3, HEIGHT, WIDTH)
        return Batch(zeros, zeros, zeros[:, :2], zeros[:, 0], ("",) * pairs)

    whole = prepared(batch(4), recipe, 5, 7, [28, 29, 30, 31])
    parts = [prepared(batch(2), recipe, 5, 7, [28, 29]), prepared(batch(2), recipe, 5, 7, [30, 31])]
    assert whole.noise is not None
    assert {part.time for part in parts} == {whole.time}
    assert torch.equal(whole.noise, torch.cat([part.noise for part in parts]))
    assert whole.noise.shape == (4, 2, HEIGHT // 8, WIDTH // 8)
    times = [prepared(batch(1), recipe, 5, step, [step]).time for step in range(300)]
    assert min(times) < 50
    assert max(times) > 950
    assert prepared(batch(1), load_recipe("raft", "ood"), 5, 0, [0]).time is None
