"""Load FlowDiffuser by name, and test the layout of the authors' files and the noise seed."""

import numpy as np
import pytest

from robustflow import load_model
from robustflow.errors import UsageError

from ..textures import noise_pair


@pytest.mark.parametrize("option", [{"seed": "first"}, {"seed": True}, {"vertical": "top"}])
def test_options_that_cannot_be_meant(option):
    with pytest.raises(UsageError, match=next(iter(option))):
        load_model("flowdiffuser", **option)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """Write seeded weights in the layout of the authors' files, which were saved from data-parallel training."""
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.models.networks.flowdiffuser import FlowDiffuser

    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("flowdiffuser") / "things.pth"
    torch.save({f"module.{key}": value for key, value in FlowDiffuser().state_dict().items()}, path)
    return path


@pytest.mark.torch
def test_the_seed_is_the_only_randomness(checkpoint):
    frames = noise_pair(30, 45)
    first, again, other = (
        load_model("flowdiffuser", checkpoint=checkpoint, device="cpu", seed=seed) for seed in (0, 0, 1)
    )
    flow = first.predict(*frames)
    assert flow.shape == (30, 45, 2)
    np.testing.assert_array_equal(flow, again.predict(*frames))
    assert np.abs(flow - other.predict(*frames)).max() > 1e-3
    assert first.identity() == again.identity() != other.identity()


@pytest.mark.torch
def test_rows_are_added_below_or_on_both_sides(checkpoint):
    frames = noise_pair(30, 45)
    below, both = (
        load_model("flowdiffuser", checkpoint=checkpoint, device="cpu", vertical=vertical).predict(*frames)
        for vertical in ("bottom", "both")
    )
    assert np.abs(below - both).max() > 1e-3
