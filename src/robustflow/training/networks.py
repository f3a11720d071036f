"""The network of a method, from the registry that `run` uses, ready for training."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ..errors import UsageError
from ..models import load_model
from ..models.catalog import PTLFLOW
from ..models.construct import parameters_of
from ..models.registry import MODELS
from ..models.tiling import TiledModel
from ..models.torch.find_checkpoint import RANDOM
from ..models.torch.fit import fitted_values, unfitted_flow
from ..models.torch.model import NetworkModel
from ..models.torch.module_net import ModuleNet
from ..models.torch.network import weights_seeded
from ..models.torch.user_model import ConventionWarning
from .corrector import Corrector
from .data.loader import Batch
from .losses.own import checked_loss
from .norms import freeze_all_norms, freeze_batchnorm, group_batchnorm
from .objectives import BrightflowObjective
from .recipe import Recipe

_NEEDED = {
    "sequence": ("predictions", "the flow of every iteration"),
    "sequence+matching": ("matched_predictions", "the flow of every iteration, and how sure it is of its matches"),
    "denoising": ("denoised_predictions", "the flows that it denoises from the truth"),
}
"""What a network must have for each loss."""
_CORRECTOR = "corrector."
"""Prefix of the names of BrightFlow's corrector, also in its authors' files."""


class TrainedNetwork(nn.Module):
    """A network as the loop calls it: RGB images 0..255 in, the flow after every iteration out.

    Args:
        model: whose network is trained; it predicts with the same weights that are being trained.
        recipe: defines how its normalisation layers behave.
        seed: of the random weights of BrightFlow's corrector, which no checkpoint of `run` holds.

    Raises:
        UsageError: a network without the method that the recipe's loss needs.
    """

    def __init__(self, model: NetworkModel, recipe: Recipe, seed: int = 0) -> None:
        super().__init__()
        method, returns = _NEEDED[recipe.loss]
        if recipe.objective is None and not hasattr(model.net, method):
            raise UsageError(
                f"model '{model.name}' cannot be trained with the loss '{recipe.loss}': its network has no method "
                f"{method} that returns {returns}"
            )
        if recipe.objective is not None and not hasattr(model.net, "both"):
            raise UsageError(
                f"model '{model.name}' cannot be trained without labels: its network has no method both(image1, "
                "image2) that returns the flows of both directions"
            )
        self.net = model.net
        for name, value in self.net.named_parameters():
            value.requires_grad_(not name.startswith(recipe.frozen))
        group_batchnorm(self.net, recipe.devices)
        self.convention = model.convention
        self._norms = recipe.frozen_norms
        self._labelled = recipe.objective is None
        self.corrector: nn.Module | None = None
        if isinstance(recipe.objective, BrightflowObjective):
            self.corrector = _seeded_corrector(seed).to(model.device)

    def train(self, mode: bool = True) -> TrainedNetwork:
        """Choose training or evaluation mode; norms that the recipe freezes stay in evaluation mode."""
        super().train(mode)
        self._inner.train(mode)  # a user's module, whose mode its wrapper does not set
        if self._norms == "batchnorm":
            freeze_batchnorm(self.net)
        elif self._norms == "all":
            freeze_all_norms(self.net)
        return self

    def forward(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Flows of float (N, 2, H, W) in pixels, the last one final, from RGB images float (N, 3, H, W) in 0..255."""
        height, width = image1.shape[2:]
        first, second = (fitted_values(image, self.convention) for image in (image1, image2))
        flows = self.net.predictions(first, second)
        return [unfitted_flow(flow, self.convention, height, width) for flow in flows]

    def matched(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], Tensor]:
        """Flows as in `forward`, and how sure the network is of the matches from which the first flow came: (N, P, P)
        for the P pixels at 1/8."""
        first, second = self._exact(image1, image2)
        flows, confidence = self.net.matched_predictions(first, second)
        return flows, confidence

    def denoised(self, image1: Tensor, image2: Tensor, truth: Tensor, time: int, noise: Tensor) -> list[Tensor]:
        """Flows denoised from the truth with the noise of a given time; see `FlowDiffuser.denoised_predictions`."""
        first, second = self._exact(image1, image2)
        flows: list[Tensor] = self.net.denoised_predictions(first, second, truth, time, noise)
        return flows

    @property
    def has_own_loss(self) -> bool:
        """Whether the user's own module has a method `loss(batch)`."""
        return isinstance(self.net, ModuleNet) and callable(getattr(self.net.module, "loss", None))

    def own_loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """The loss that the user's own module returns.

        Args:
            batch: the module gets a dictionary: `image1` and `image2` float (N, 3, H, W) as it declares that it takes
                images, `flow` (N, 2, H, W) in pixels, `valid` (N, H, W), 1 where the flow is known.

        Raises:
            UsageError: it returned no loss, or cannot take this crop.
        """
        first, second = self._exact(batch.image1, batch.image2)
        module: Any = self._inner
        return checked_loss(module.loss({"image1": first, "image2": second, "flow": batch.flow, "valid": batch.valid}))

    def _exact(self, image1: Tensor, image2: Tensor) -> tuple[Tensor, Tensor]:
        """The images as the network takes them; refused if they would be padded, because the ground truth is not."""
        first, second = (fitted_values(image, self.convention) for image in (image1, image2))
        if first.shape != image1.shape:
            height, width = first.shape[2:]
            raise UsageError(
                f"this loss compares the network's own pixels with the ground truth, and a crop of {image1.shape[2]}x"
                f"{image1.shape[3]} would be padded to {height}x{width}; give --crop {height}x{width}"
            )
        return first, second

    def weights(self) -> dict[str, Tensor]:
        """The network's state under the names of its authors' files, which `run --checkpoint` reads."""
        state = self._inner.state_dict()
        if self.corrector is not None:
            state |= {f"{_CORRECTOR}{name}": value for name, value in self.corrector.state_dict().items()}
        return {name: value.detach().cpu() for name, value in state.items()}

    def load_weights(self, weights: dict[str, Tensor]) -> None:
        """Load what `weights` returned."""
        own = {name: value for name, value in weights.items() if not name.startswith(_CORRECTOR)}
        self._inner.load_state_dict(own)
        if self.corrector is not None:
            rest = {name.removeprefix(_CORRECTOR): weights[name] for name in weights.keys() - own.keys()}
            self.corrector.load_state_dict(rest)

    @property
    def _inner(self) -> nn.Module:
        if not self._labelled:
            return self.net
        wrapped: Any = getattr(self.net, "model", None) or getattr(self.net, "module", None)
        return wrapped if isinstance(wrapped, nn.Module) else self.net


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
) -> tuple[NetworkModel, TrainedNetwork]:
    """The model of a recipe with the weights it starts from, and its network ready to learn.

    Args:
        recipe: names the method and its iterations.
        start: a checkpoint as for `run --checkpoint`, or "random".
        device: as for `run --device`.
        options: further options of the model.
        seed: of random weights.

    Raises:
        ModelError: no such checkpoint, or one of another network.
        UsageError: a model that cannot be trained.
    """
    given = {**(options or {}), "device": device}
    own = ":" in recipe.method and not recipe.method.startswith(PTLFLOW)
    if recipe.iterations is not None and not own and _takes_iterations(recipe.method):
        given["iterations"] = recipe.iterations
    if not (own and str(start) == RANDOM):  # a user's module keeps the weights that it was made with
        given["checkpoint"] = str(start)
    with torch.random.fork_rng(devices=[]), weights_seeded(seed), warnings.catch_warnings():
        torch.default_generator.manual_seed(seed)  # of a user's module
        if str(start) == RANDOM:  # which measures nothing yet
            warnings.simplefilter("ignore", ConventionWarning)
        model = load_model(recipe.method, **given)
    while isinstance(model, TiledModel):
        model = model.model
    if not isinstance(model, NetworkModel):
        raise UsageError(f"model '{recipe.method}' is not a PyTorch network of this package, so it cannot be trained")
    if recipe.objective is not None and recipe.objective.kind != "brightflow" and str(start) == RANDOM:
        kaiming(model.net, seed)
    return model, TrainedNetwork(model, recipe, seed)


def kaiming(network: nn.Module, seed: int = 0) -> None:
    """The initial weights of ARFlow and UPFlow: He et al.'s normal ones, no biases; the same for the same seed."""
    generator = torch.Generator().manual_seed(seed)
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            drawn = torch.empty(module.weight.shape)
            nn.init.kaiming_normal_(drawn, generator=generator)
            with torch.no_grad():
                module.weight.copy_(drawn)
                if module.bias is not None:
                    module.bias.zero_()


def learning_parameters(network: nn.Module) -> list[nn.Parameter]:
    """The parameters that are trained."""
    return [value for value in network.parameters() if value.requires_grad]


def _takes_iterations(method: str) -> bool:
    return method not in MODELS or "iterations" in parameters_of(MODELS.get(method))
