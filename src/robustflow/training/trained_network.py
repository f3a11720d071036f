"""Prepare the network of a method, from the registry that `run` uses, for training: initial weights, BatchNorm as in
the original code, and BrightFlow's brightness corrector (Marsal et al., WACV 2023).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..core.errors import UsageError, first_line
from ..models import load_model
from ..models.networks.blocks.raft import convex_upsample, mask_layers
from ..models.networks.brightflow import ResidualEncoder
from ..models.tiling import TiledModel
from ..models.torch.build import RANDOM, weights_seeded
from ..models.torch.network_model import NetworkModel, fitted_values, unfitted_flow
from ..models.torch.user_model import ModuleNet
from .data.loader import Batch
from .recipe import BrightflowObjective, Recipe, is_own, takes_iterations

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


_FEATURES = 128


class Corrector(ResidualEncoder):
    """Predict colour offsets for an image from the image, the second image warped to it by the flow, and a visibility
    mask.
    """

    def __init__(self) -> None:
        super().__init__(_FEATURES, inputs=7)
        self.offset_head = nn.ModuleDict(
            {"conv1": nn.Conv2d(_FEATURES, 256, 3, padding=1), "conv2": nn.Conv2d(256, 3, 3, padding=1)}
        )
        self.mask = mask_layers()

    def forward(self, image: Tensor) -> Tensor:
        """Return colour offsets (N, 3, H, W), -1..1 as fractions of the image's range."""
        features = super().forward(image)
        offsets = torch.tanh(self.offset_head["conv2"](torch.relu(self.offset_head["conv1"](features))))
        return convex_upsample(offsets / 8, 0.25 * self.mask(features), 8)


_NEEDED = {
    "sequence": ("predictions", "the flow of every iteration"),
    "sequence+matching": ("matched_predictions", "the flow of every iteration, and the confidence of its matches"),
    "denoising": ("denoised_predictions", "flows denoised from ground truth"),
}
"""The method that a network needs for each loss, and what that method returns."""
_MIXED = {"bf16": torch.bfloat16, "fp16": torch.float16}
"""The data type of each mixed-precision mode."""
_CORRECTOR = "corrector."
"""Prefix of the parameter names of BrightFlow's corrector, also in its authors' files."""


class TrainedNetwork(nn.Module):
    """A network in the form used by the loop: it maps RGB images in 0..255 to the flow after every iteration."""

    def __init__(self, model: NetworkModel, recipe: Recipe, seed: int = 0) -> None:
        super().__init__()
        method, returns = _NEEDED[recipe.loss]
        if recipe.objective is None and not hasattr(model.net, method):
            raise UsageError(
                model.name,
                f"cannot be trained with the loss '{recipe.loss}': its network has no method {method} that returns "
                f"{returns}",
            )
        if recipe.objective is not None and not hasattr(model.net, "both"):
            raise UsageError(
                model.name,
                "cannot be trained without labels: its network has no method both(image1, image2) that returns the "
                "flows of both directions",
            )
        if min(recipe.crop) < model.convention.smallest:
            raise UsageError(
                "--crop",
                f"below {model.convention.smallest} pixels per side, {model.name} returns NaN or fails; enlarge it",
            )
        self.net = model.net
        for name, value in self.net.named_parameters():
            value.requires_grad_(name not in model.frozen and not name.startswith(recipe.frozen))
        if not isinstance(self.net, ModuleNet):  # a user's network was not trained on the original's devices
            group_batchnorm(self.net, recipe.devices)
        self.convention = model.convention
        self._norms = recipe.frozen_norms
        self._labelled = recipe.objective is None
        self.corrector: nn.Module | None = None
        if isinstance(recipe.objective, BrightflowObjective):
            self.corrector = _seeded_corrector(seed).to(model.device)
        other = next(
            (name for name, value in self._network.state_dict().items() if not isinstance(value, Tensor)), None
        )
        if other is not None:
            raise UsageError(model.name, f"cannot be trained: '{other}' in its state_dict is not a tensor; remove it")

    def train(self, mode: bool = True) -> TrainedNetwork:
        """Set training or evaluation mode; normalisation layers frozen by the recipe remain in evaluation mode."""
        super().train(mode)
        self._network.train(mode)  # a user's module, whose mode is not set by its wrapper
        if self._norms == "batchnorm":
            freeze_batchnorm(self.net)
        elif self._norms == "all":
            freeze_all_norms(self.net)
        return self

    def forward(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Predict flows, each float (N, 2, H, W) in pixels, the last one final, from RGB images, float (N, 3, H, W),
        0..255."""
        height, width = image1.shape[2:]
        first, second = (fitted_values(image, self.convention) for image in (image1, image2))
        flows = self.net.predictions(first, second)
        return [unfitted_flow(flow, self.convention, height, width) for flow in flows]

    def matched(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], Tensor]:
        """Predict flows as in `forward`, and the confidence of the matches that initialise the flow, (N,
        P, P) for the P pixels at 1/8 resolution."""
        first, second = self._exact(image1, image2)
        flows, confidence = self.net.matched_predictions(first, second)
        return flows, confidence

    def denoised(self, image1: Tensor, image2: Tensor, truth: Tensor, time: int, noise: Tensor) -> list[Tensor]:
        """Predict flows denoised from ground truth with the noise of a given step; see
        `FlowDiffuser.denoised_predictions`."""
        first, second = self._exact(image1, image2)
        flows: list[Tensor] = self.net.denoised_predictions(first, second, truth, time, noise)
        return flows

    @property
    def has_own_loss(self) -> bool:
        """Return whether the user's module has a method `loss(batch)`."""
        return isinstance(self.net, ModuleNet) and callable(getattr(self.net.module, "loss", None))

    def own_loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """Return the loss computed by the user's module."""
        first, second = self._exact(batch.image1, batch.image2)
        module: Any = self._network
        return checked_loss(module.loss({"image1": first, "image2": second, "flow": batch.flow, "valid": batch.valid}))

    def _exact(self, image1: Tensor, image2: Tensor) -> tuple[Tensor, Tensor]:
        """Convert images to the network's input format; raise if they would be padded, because the ground truth is not
        padded."""
        first, second = (fitted_values(image, self.convention) for image in (image1, image2))
        if first.shape != image1.shape:
            height, width = first.shape[2:]
            raise UsageError(
                "--crop",
                f"this loss does not support padded input, but {image1.shape[2]}x{image1.shape[3]} would be padded; "
                f"use {height}x{width}",
            )
        return first, second

    def weights(self) -> dict[str, Tensor]:
        """Return the network's state with the parameter names of its authors' files, which `run --checkpoint` can
        read."""
        state = self._network.state_dict()
        if self.corrector is not None:
            state |= {f"{_CORRECTOR}{name}": value for name, value in self.corrector.state_dict().items()}
        return {name: value.detach().cpu() for name, value in state.items()}

    def load_weights(self, weights: dict[str, Tensor]) -> None:
        """Load a state returned by `weights`."""
        if self.corrector is not None:
            own = {name: value for name, value in weights.items() if not name.startswith(_CORRECTOR)}
            rest = {name.removeprefix(_CORRECTOR): weights[name] for name in weights.keys() - own.keys()}
            self.corrector.load_state_dict(rest)
            weights = own
        self._network.load_state_dict(weights)

    @property
    def _network(self) -> nn.Module:
        if not self._labelled:
            return self.net
        wrapped: Any = getattr(self.net, "model", None) or getattr(self.net, "module", None)
        return wrapped if isinstance(wrapped, nn.Module) else self.net


def checked_loss(returned: object) -> tuple[Tensor, dict[str, float]]:
    """Check the return value of a network's `loss`: a scalar tensor, or a scalar tensor and a dictionary of values for
    the log.

    >>> checked_loss((torch.ones(()), {"photometric": torch.tensor(2.0)}))
    (tensor(1.), {'photometric': 2.0})
    """
    loss, numbers = returned if isinstance(returned, tuple) and len(returned) == 2 else (returned, {})
    if not isinstance(loss, Tensor) or loss.numel() != 1 or not isinstance(numbers, dict):
        raise UsageError(
            "loss(batch)",
            f"the network's method returned {type(returned).__name__}; return a scalar tensor, or one and a "
            "dictionary of numbers for the log",
        )
    try:
        return loss.reshape(()), {str(name): float(torch.as_tensor(value).item()) for name, value in numbers.items()}
    except (TypeError, ValueError, RuntimeError) as error:
        raise UsageError(
            "loss(batch)",
            f"the network's method returned values for the log that are not numbers ({first_line(error)}); return one "
            "number for each name",
        ) from error


def _seeded_corrector(seed: int) -> Corrector:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Corrector()


def load_network(
    recipe: Recipe,
    start: str | Path,
    device: str = "cpu",
    options: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> tuple[Any, TrainedNetwork]:
    """Return the model of a recipe with its initial weights, which predicts as in a run (in tiles, if it does so by
    default), and its network ready for training.
    """
    given = {**(options or {}), "device": device}
    if recipe.iterations is not None and takes_iterations(recipe.method):
        given["iterations"] = recipe.iterations
    if not (is_own(recipe.method) and str(start) == RANDOM):  # a user's module keeps its initial weights
        given["checkpoint"] = str(start)
    with torch.random.fork_rng(devices=[]), weights_seeded(seed):
        torch.default_generator.manual_seed(seed)  # seeds the weights of a user's module
        model = load_model(recipe.method, **given)
    trained = model.model if isinstance(model, TiledModel) else model
    if not isinstance(trained, NetworkModel):
        raise UsageError(recipe.method, "not a PyTorch network of this package, so it cannot be trained")
    if recipe.objective is not None and recipe.objective.kind != "brightflow" and str(start) == RANDOM:
        kaiming(trained.net, seed)
    return model, TrainedNetwork(trained, recipe, seed)


def kaiming(network: nn.Module, seed: int = 0) -> None:
    """Set the initial weights of ARFlow and UPFlow: He et al.'s normal initialisation and zero biases; reproducible
    with the same seed."""
    generator = torch.Generator().manual_seed(seed)
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            drawn = torch.empty(module.weight.shape)
            nn.init.kaiming_normal_(drawn, generator=generator)
            with torch.no_grad():
                module.weight.copy_(drawn)
                if module.bias is not None:
                    module.bias.zero_()


def mixed_precision(image: Tensor, recipe: Recipe) -> torch.autocast:
    """Return a context that computes in the recipe's precision on the image's device."""
    return torch.autocast(image.device.type, _MIXED.get(recipe.precision), enabled=recipe.precision in _MIXED)


def learning_parameters(network: nn.Module) -> list[nn.Parameter]:
    """Return the trainable parameters."""
    return [value for value in network.parameters() if value.requires_grad]
