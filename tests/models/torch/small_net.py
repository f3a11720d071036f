"""A network small enough for tests of checkpoints, loading of one, and the content of a hostile file."""

from __future__ import annotations

import os

import pytest
import torch

from robustflow.models.torch.checkpoint import read_checkpoint
from robustflow.models.torch.weights import load_weights


class Payload:
    """An object whose pickle runs a command when it is loaded unsafely."""

    def __init__(self, marker) -> None:
        self.marker = marker

    def __reduce__(self):
        return os.system, (f"touch {self.marker}",)


class Net(torch.nn.Module):
    """A small network with a parameter, a float buffer and an integer buffer."""

    def __init__(self) -> None:
        super().__init__()
        self.first = torch.nn.Conv2d(3, 4, 3)
        self.norm = torch.nn.BatchNorm2d(4)


class BelowModel(torch.nn.Module):
    """A network whose own names begin with one of the known prefixes, as BrightFlow's do."""

    def __init__(self) -> None:
        super().__init__()
        self.model = Net()


def net_state():
    """The network's seeded weights, including statistics."""
    torch.manual_seed(0)
    net = Net()
    net.norm.running_mean.normal_()
    return net.state_dict()


def load(path, net=None, **options):
    """Load the weights into the network; returns the network, the checkpoint, and the dtype from which
    they were cast.
    """
    net = net or Net()
    read = read_checkpoint(path, options.pop("sha256", None))
    return net, read, load_weights(net, read, "small", **options)


def one_line(error: pytest.ExceptionInfo) -> str:
    """The message of a refused checkpoint, which must be one line."""
    text = str(error.value)
    assert "\n" not in text
    return text
