"""Apply corruptions to tensors with a torchvision v2 transform (requires the extra `torch`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.utils._pytree import tree_flatten, tree_unflatten
from torchvision import tv_tensors

from ..core.arguments import SEVERITIES
from ..core.errors import DataError
from .corruption import Corruption
from .transform import CorruptionTransform


class TorchCorruption(torch.nn.Module):
    """A `CorruptionTransform` for tensors: images (C, H, W) with C = 1 or 3, or batches (B, C, H, W).

    Tensors are uint8, or float32 in [0, 1]. As in torchvision v2, the input may be any structure of lists, tuples and
    dicts: every `tv_tensors.Image` in it is corrupted, and everything else is returned unchanged. If there is no
    `tv_tensors.Image`, every plain tensor is treated as an image. All images in a call belong together (frame 1, frame
    2, ...) and share one random draw, while the items of a batch are drawn independently.

    Accepts the same arguments as `CorruptionTransform`; see the docstring of the module `transform` for how draws
    differ between `DataLoader` workers.

    >>> transform = TorchCorruption(["contrast"], severities=[5])
    >>> first, second = transform(torch.zeros(3, 24, 32), torch.ones(3, 24, 32))
    >>> first.shape, first.dtype
    (torch.Size([3, 24, 32]), torch.float32)
    >>> transform
    TorchCorruption(names=['contrast'], severities=[5], probability=1.0, seed=0)
    """

    def __init__(
        self,
        names: Sequence[str | Corruption | type[Corruption]] | None = None,
        severities: Sequence[int] = SEVERITIES,
        probability: float = 1.0,
        seed: int = 0,
        variant: str = "default",
        scale: str = "paper",
    ) -> None:
        super().__init__()
        self._transform = CorruptionTransform(names, severities, probability, seed, variant, scale)

    def forward(self, *inputs: Any, key: str | int | None = None) -> Any:
        """Corrupt the images among the inputs.

        Args:
            inputs: tensors, or a structure that contains tensors. Corruptions do not propagate gradients.
            key: name of the random draw; each item of a batch has a separate key, derived from `key` and its index.

        Returns:
            The same structure (a tuple for several inputs), with tensors of the same class, dtype and device.

        Raises:
            DataError: the inputs contain no image, or an image is not supported by `CorruptionTransform`.
        """
        leaves, structure = tree_flatten(inputs if len(inputs) != 1 else inputs[0])
        places = [place for place, leaf in enumerate(leaves) if isinstance(leaf, tv_tensors.Image)]
        places = places or [place for place, leaf in enumerate(leaves) if _is_plain(leaf)]
        if not places:
            raise DataError("inputs", "no image among them; expected tensors (C, H, W) or (B, C, H, W)")
        images = [leaves[place] for place in places]
        for place, image, corrupted in zip(places, images, self._corrupt(images, key), strict=True):
            fresh = torch.from_numpy(corrupted).to(image.device)
            leaves[place] = fresh if _is_plain(image) else tv_tensors.wrap(fresh, like=image)
        return tree_unflatten(leaves, structure)

    def extra_repr(self) -> str:
        return repr(self._transform).partition("(")[2].removesuffix(")")

    def _corrupt(self, images: list[torch.Tensor], key: str | int | None) -> list[Any]:
        for image in images:
            if image.ndim not in (3, 4) or not image.numel() or image.shape != images[0].shape:
                shapes = ", ".join(str(tuple(image.shape)) for image in images)
                raise DataError(shapes, "the shapes of the images; expected (C, H, W) or (B, C, H, W) for all images")
            if image.dtype not in (torch.uint8, torch.float32):
                raise DataError(image.dtype, "the dtype of an image; expected torch.uint8, or torch.float32 in [0, 1]")
        arrays = [np.moveaxis(image.detach().cpu().numpy(), -3, -1) for image in images]
        if images[0].ndim == 3:
            return [_channels_first(out) for out in self._transform(arrays, key)]
        items = []
        for item, frames in enumerate(zip(*arrays, strict=True)):
            items.append(self._transform(list(frames), None if key is None else f"{key}/{item}"))
        return [_channels_first(np.stack(frames)) for frames in zip(*items, strict=True)]


def _is_plain(leaf: Any) -> bool:
    return isinstance(leaf, torch.Tensor) and not isinstance(leaf, tv_tensors.TVTensor)


def _channels_first(array: Any) -> Any:
    return np.ascontiguousarray(np.moveaxis(array, -1, -3))
