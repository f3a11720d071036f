"""A network small enough for tests of checkpoints, how they load one, and what a hostile file would hold."""

from __future__ import annotations

import os

import pytest
import torch

from robustflow.models.torch.checkpoint import read_checkpoint
from robustflow.models.torch.weights import load_weights


class Payload:
    """A pickle of this runs a command when it is loaded unsafely."""

    def __init__(self, marker) -> None:
        self.marker = marker

    def __reduce__(self):
        return os.system, (f"touch {self.marker}",)


class Net(torch.nn.Module):
    """Small, with a parameter, a float buffer and an integer one."""

    def __init__(self) -> None:
        super().__init__()
        self.first = torch.nn.Conv2d(3, 4, 3)
        self.norm = torch.nn.BatchNorm2d(4)


class BelowModel(torch.nn.Module):
    """A network whose own names begin with one of the prefixes, as BrightFlow's do."""

    def __init__(self) -> None:
        super().__init__()
        self.model = Net()


def net_state():
    """The network's seeded weights, statistics among them."""
    torch.manual_seed(0)
    net = Net()
    net.norm.running_mean.normal_()
    return net.state_dict()


def load(path, net=None, **options):
    """The network, what was read, and what its weights were cast from."""
    net = net or Net()
    read = read_checkpoint(path, options.pop("sha256", None))
    return net, read, load_weights(net, read, "small", **options)


def one_line(error: pytest.ExceptionInfo) -> str:
    """The message, which must be one line."""
    text = str(error.value)
    assert "\n" not in text
    return text
