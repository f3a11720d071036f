"""Compare the tensor transform with the array transform for structures, batches and DataLoader workers."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")
pytestmark = pytest.mark.torch

from torch.utils.data import DataLoader, Dataset  # noqa: E402
from torchvision import tv_tensors  # noqa: E402
from torchvision.transforms import v2  # noqa: E402

from robustflow.core.errors import DataError  # noqa: E402
from robustflow.corruptions.torch_transform import TorchCorruption  # noqa: E402
from robustflow.corruptions.transform import CorruptionTransform  # noqa: E402

from ..refusals import refusal  # noqa: E402


def image(seed=0, size=(3, 24, 32)):
    return torch.from_numpy(np.random.default_rng(seed).integers(0, 256, size).astype(np.uint8))


@pytest.mark.parametrize("channels", [1, 3])
def test_torch_transform_equals_the_plain_one_with_channels_first(channels):
    pair = [image(seed, (channels, 24, 32)) for seed in (0, 1)]
    out = TorchCorruption(["snow"], [3], seed=4)(*pair, key="a")
    expected = CorruptionTransform(["snow"], [3], seed=4)([t.permute(1, 2, 0).numpy() for t in pair], key="a")
    for got, want in zip(out, expected, strict=True):
        np.testing.assert_array_equal(got.permute(1, 2, 0).numpy(), want)
        assert got.is_contiguous()


def test_items_of_a_batch_have_independent_draws_and_frames_of_a_pair_share_theirs():
    transform = TorchCorruption(["frost"], [4])
    batch = torch.stack([image(3)] * 3)
    first, second = transform(batch, batch, key="b")
    assert torch.equal(first, second)  # the same frost texture in both frames
    assert not torch.equal(first[0], first[1])
    assert torch.equal(first[2], transform(image(3), key="b/2"))


def test_transform_of_a_structure_changes_only_its_images():
    sample = {"image1": tv_tensors.Image(image(0)), "image2": tv_tensors.Image(image(1)), "flow": torch.rand(2, 24, 32)}
    out = TorchCorruption(["contrast"], [5])(sample)
    assert isinstance(out["image1"], tv_tensors.Image)
    assert not torch.equal(out["image2"], sample["image2"])
    assert out["flow"] is sample["flow"]


def test_masks_beside_a_plain_tensor_are_returned_unchanged():
    grey, mask = image(0, (1, 24, 32)), tv_tensors.Mask(image(1, (1, 24, 32)))
    out, out_mask = TorchCorruption(["contrast"], [5])(grey, mask)
    assert not torch.equal(out, grey)
    assert out_mask is mask


def test_torch_transform_composes_with_torchvision():
    chain = v2.Compose([v2.ToDtype(torch.float32, scale=True), TorchCorruption(["gaussian_noise"]), v2.CenterCrop(16)])
    out = chain(tv_tensors.Image(image()))
    assert out.shape == (3, 16, 16)
    assert out.dtype == torch.float32
    assert 0 <= out.min() <= out.max() <= 1


@pytest.mark.parametrize(
    ("tensors", "culprit"),
    [
        ((torch.zeros(3, 8, 8, dtype=torch.float16),), "torch.float16"),
        ((torch.zeros(3, 8, 8, dtype=torch.uint16),), "torch.uint16"),
        ((torch.zeros(2, 8, 8),), "(8, 8, 2)"),
        ((torch.zeros(8, 8),), "(8, 8)"),
        ((torch.zeros(0, 3, 8, 8),), "(0, 3, 8, 8)"),
        ((torch.zeros(3, 8, 8), torch.zeros(3, 8, 9)), "(3, 8, 8), (3, 8, 9)"),
        ((torch.full((3, 8, 8), 2.0),), "2 to 2"),
        (({"flow": 3},), "inputs"),
        ((tv_tensors.Video(image(0, (4, 3, 8, 8))),), "inputs"),
    ],
)
def test_torch_transform_of_an_object_that_is_no_image_is_refused(tensors, culprit):
    refusal(lambda: TorchCorruption(["contrast"])(*tensors), DataError, culprit)


class Same(Dataset):
    """Returns the same uniform image many times, so any difference is caused by a separate random draw."""

    def __init__(self, keyed):
        self.keyed = keyed
        self.transform = TorchCorruption(["gaussian_noise"], [3])

    def __len__(self):
        return 12

    def __getitem__(self, index):
        return self.transform(torch.full((3, 16, 16), 0.5), key=index if self.keyed else None)


def epochs(workers, keyed, count=1):
    torch.manual_seed(0)
    loader = DataLoader(Same(keyed), batch_size=2, num_workers=workers)
    return [[item.numpy().tobytes() for batch in loader for item in batch] for _ in range(count)]


@pytest.mark.parametrize("workers", [0, 2])
def test_every_sample_of_every_epoch_has_a_different_draw(workers):
    drawn = epochs(workers, keyed=False, count=2)
    assert len({item for epoch in drawn for item in epoch}) == 24
    assert drawn == epochs(workers, keyed=False, count=2)


def test_with_keys_the_number_of_workers_changes_nothing():
    assert epochs(0, keyed=True) == epochs(2, keyed=True)
