"""A small network for tests of checkpoints, its weights, and the payload of a malicious file."""

import os

import torch

from robustflow.models.torch.checkpoint import load_weights, read_checkpoint


class Payload:
    """An object whose pickle executes a command if it is loaded unsafely."""

    def __init__(self, marker) -> None:
        self.marker = marker

    def __reduce__(self):
        return os.system, (f"touch {self.marker}",)


class Net(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.first = torch.nn.Conv2d(3, 4, 3)
        self.norm = torch.nn.BatchNorm2d(4)


class BelowModel(torch.nn.Module):
    """A network whose own parameter names begin with one of the known prefixes, like those of BrightFlow."""

    def __init__(self) -> None:
        super().__init__()
        self.model = Net()


def net_state():
    """Seeded weights of the network, including running statistics."""
    torch.manual_seed(0)
    net = Net()
    net.norm.running_mean.normal_()
    return net.state_dict()


def load(path, net=None, **options):
    """Load the weights into the network; return the network, the checkpoint, and the original dtype."""
    net = net or Net()
    read = read_checkpoint(path, options.pop("sha256", None))
    return net, read, load_weights(net, read, "small", **options)
