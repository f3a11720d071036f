"""Test which accelerators a run uses."""

import sys
from types import SimpleNamespace

import pytest

from robustflow.core.errors import UsageError
from robustflow.models import ModelSpec
from robustflow.models.loading import device_of, devices_of


class On:
    def __init__(self, device):
        self.device = device


def _spec(name, device=None):
    return ModelSpec(name, (("device", device),) if device else ())


@pytest.fixture
def four_gpus(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(cuda=SimpleNamespace(device_count=lambda: 4)))


@pytest.mark.parametrize(
    ("device", "is_on"),
    [
        ("cuda:1", "cuda:1"),
        (SimpleNamespace(type="cuda"), "namespace(type='cuda')"),
        (None, "cpu"),
        (print, "cpu"),
        ("", "cpu"),
    ],
)
def test_device_of_a_model_is_normalised(device, is_on):
    assert device_of(On(device)) == is_on


EVERY = ("cuda:0", "cuda:1", "cuda:2", "cuda:3")


@pytest.mark.parametrize(
    ("name", "option", "model", "devices"),
    [
        ("raft", None, On("cpu"), ()),
        (None, None, object(), ()),
        ("raft", None, On("cuda"), EVERY),
        ("raft", "cuda", On("cuda"), EVERY),
        ("mine:Model", "cuda", On("cuda"), EVERY),
        ("raft", "cuda:2", On("cuda:2"), ("cuda:2",)),
        ("raft", "cuda:2, cuda:3", On("cuda:2"), ("cuda:2", "cuda:3")),
        # a user's model that is given no device is where it says
        ("mine:Model", None, On("cuda"), ("cuda",)),
        (None, None, On("cuda"), ("cuda",)),
    ],
)
def test_cuda_is_every_visible_gpu_and_a_number_is_that_one(four_gpus, name, option, model, devices):
    assert devices_of(name and _spec(name, option), model) == devices


def test_list_of_devices_must_be_of_gpus():
    with pytest.raises(UsageError, match="only GPUs can be listed"):
        devices_of(_spec("raft", "cuda:0,cpu"), On("cuda:0"))


def test_the_number_of_devices_is_not_part_of_an_identity():
    model = SimpleNamespace(identity=lambda: {"name": "mine"})
    assert _spec("m", "cuda:0,cuda:1").identity(model) == _spec("m", "cuda:2,cuda:3").identity(model)
