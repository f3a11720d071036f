"""BatchNorm during training as in the original code: frozen, or computed over the part of a batch on one GPU."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

_BATCHNORM = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm)
_INSTANCENORM = (nn.InstanceNorm1d, nn.InstanceNorm2d, nn.InstanceNorm3d)


def freeze_batchnorm(network: nn.Module) -> None:
    """Make every BatchNorm use its running statistics without updating them, like RAFT's `freeze_bn`; scale and shift
    are still trained. Call it again after each `network.train()`."""
    for module in network.modules():
        if isinstance(module, _BATCHNORM):
            module.eval()


def freeze_all_norms(network: nn.Module) -> None:
    """Put every normalisation layer that has running statistics into evaluation mode (SAMFlow). Call it again after
    each `network.train()`."""
    for module in network.modules():
        if isinstance(module, (*_BATCHNORM, *_INSTANCENORM)):
            module.eval()


def group_batchnorm(network: nn.Module, groups: int) -> None:
    """Make every BatchNorm of a network work on `groups` equal parts of a batch, like `DataParallel` on `groups`
    GPUs (see `GroupedBatchNorm2d`). A single group has no effect."""
    if groups == 1:
        return
    replaced: dict[nn.Module, GroupedBatchNorm2d] = {}  # RAFT registers the same norm under two names
    for parent in list(network.modules()):
        for name, child in list(parent.named_children()):
            if isinstance(child, nn.BatchNorm2d):
                setattr(parent, name, replaced.setdefault(child, GroupedBatchNorm2d(child, groups)))


class GroupedBatchNorm2d(nn.BatchNorm2d):
    """BatchNorm that normalises each of `groups` parts of a batch separately; only the first part updates the running
    statistics.
    """

    def __init__(self, norm: nn.BatchNorm2d, groups: int) -> None:
        super().__init__(norm.num_features, norm.eps, norm.momentum, norm.affine, norm.track_running_stats)
        self.groups = groups
        self.weight, self.bias = norm.weight, norm.bias
        self.running_mean, self.running_var = norm.running_mean, norm.running_var
        self.num_batches_tracked = norm.num_batches_tracked
        self.train(norm.training)

    def forward(self, inputs: Tensor) -> Tensor:
        """Normalise the input; in training mode, each part separately."""
        if not self.training:
            return super().forward(inputs)
        first, *others = inputs.chunk(self.groups)
        normalised = [super().forward(first)]
        normalised += [F.batch_norm(part, None, None, self.weight, self.bias, True, 0.0, self.eps) for part in others]
        return torch.cat(normalised)
