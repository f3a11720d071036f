"""BrightFlow: RAFT under a census loss whose frames a second network corrects in brightness, and self-supervision."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..data.loader import Batch
from ..losses.brightflow import ALPHA, masked_census, over_iterations, seen_of, self_supervised, student_image
from ..losses.dilated_warp import dilated_warp, leaves
from ..losses.smoothness import robust_smoothness
from ..networks import TrainedNetwork
from ..objectives import BrightflowObjective
from ..recipe import Recipe
from .objective import LabelFree, Moment


class _Way(NamedTuple):
    """One direction: its image and the whole other one, in -1..1, its flows by iteration, and where it is seen."""

    image: Tensor
    other: Tensor
    flows: list[Tensor]
    seen: Tensor


class Brightflow(LabelFree):
    """Marsal et al., WACV 2023, from its description."""

    def __init__(self, network: TrainedNetwork, recipe: Recipe, settings: BrightflowObjective) -> None:
        super().__init__(network, recipe)
        self._settings = settings

    def forward(self, batch: Batch, moment: Moment) -> tuple[Tensor, dict[str, Tensor]]:
        """See `LabelFree.forward`."""
        assert batch.whole is not None, "the loader gives the whole frames"
        settings, whole = self._settings, batch.whole
        first, second = self.images(batch.image1), self.images(batch.image2)
        there, back = ([flow.float() for flow in flows] for flows in self.both(first, second))
        ways = []
        for image, other, own, opposite in (
            (first, whole.image2, there, back),
            (second, whole.image1, back, there),
        ):
            seen = seen_of(own[-1], opposite[-1], settings.occlusion)
            seen = torch.maximum(seen, leaves(own[-1].detach()))  # what leaves the crop is fetched from the whole frame
            ways.append(_Way(image, self.images(other), own, seen))
        corrects = settings.corrector > 0 and moment.share >= settings.corrector_from
        targets, corrector = zip(*(self._corrected(way, batch, moment, corrects) for way in ways), strict=True)
        numbers = {
            "photometric": sum(
                self._photometric(way, target, batch) for way, target in zip(ways, targets, strict=True)
            ),
            "smoothness": sum(self._smoothness(way) for way in ways),
        }
        loss = (settings.census * numbers["photometric"] + settings.smooth * numbers["smoothness"]) / 2
        if corrects:
            numbers["corrector"] = (corrector[0] + corrector[1]) / 2
            loss = loss + settings.corrector * numbers["corrector"]
        weight = self._self_supervision(moment)
        if weight:
            numbers["self_supervision"] = self._students(first, second, there[-1], back[-1])
            loss = loss + weight * numbers["self_supervision"]
        return loss, {"flow": there[-1], **numbers}

    def _corrected(self, way: _Way, batch: Batch, moment: Moment, corrects: bool) -> tuple[Tensor, Tensor]:
        """The image that the photometric loss compares, and the corrector's own loss: the mean absolute difference of
        the corrected image and what the final flow finds, of values -1..1."""
        if not corrects:
            return way.image, way.image.new_zeros(())
        assert self.network.corrector is not None
        warped, inside = self._warped(way, way.flows[-1].detach(), batch)
        seen = way.seen * inside
        with self.autocast(warped):
            offsets = self.network.corrector(way.image, warped, seen).float()
        corrected = (way.image + offsets).clamp(-1.0, 1.0)  # 0..255
        loss = ((corrected - warped).abs() * seen).mean() / (seen.mean() + 1e-6)
        if moment.share < self._settings.corrected_from:
            return way.image, loss
        corrected = corrected.detach()
        better = (corrected - warped).abs() < (way.image - warped).abs()
        return torch.where(better, corrected, way.image), loss

    def _photometric(self, way: _Way, target: Tensor, batch: Batch) -> Tensor:
        losses = []
        for flow in way.flows:
            warped, inside = self._warped(way, flow, batch)
            losses.append(masked_census((target + 1) / 2, (warped + 1) / 2, way.seen * inside.detach()))
        return over_iterations(losses)

    def _smoothness(self, way: _Way) -> Tensor:
        image, second_order = (way.image + 1) / 2, self._settings.second_order
        return over_iterations([robust_smoothness(flow, image, ALPHA, second_order) for flow in way.flows])

    def _warped(self, way: _Way, flow: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
        assert batch.whole is not None
        return dilated_warp(way.other, flow, batch.whole.corners, batch.whole.sizes)

    def _self_supervision(self, moment: Moment) -> float:
        """Its weight: 0, then rising."""
        begins, ends = self._settings.self_supervision_from, self._settings.self_supervision_to
        risen = (moment.share - begins) / max(ends - begins, 1e-9)
        return self._settings.self_supervision * min(max(risen, 0.0), 1.0)

    def _students(self, first: Tensor, second: Tensor, forward: Tensor, backward: Tensor) -> Tensor:
        border = self._settings.border
        there, back = self.both(student_image(first, border), student_image(second, border))
        losses = (
            self_supervised([flow.float() for flow in there], forward, border),
            self_supervised([flow.float() for flow in back], backward, border),
        )
        return (losses[0] + losses[1]) / 2
