"""BrightFlow: RAFT trained with self-supervision and a census loss on frames whose brightness a second network
corrects."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from ..data.loader import Batch, WholeFrames
from ..losses.terms import dilated_warp, robust_smoothness
from ..losses.unsupervised import (
    ALPHA,
    correction_loss,
    kept_offsets,
    masked_census,
    over_iterations,
    self_supervised,
    visibility,
    with_offsets,
)
from ..recipe import BrightflowObjective, Recipe
from ..trained_network import TrainedNetwork
from .methods import LabelFree, TrainingStep

FARTHEST = 100.0
"""Upper limit of the self-supervision loss of a vector, in pixels."""


class _Frames(NamedTuple):
    """Both frames of each pair, uncropped and cropped, RGB in 0..255."""

    whole: tuple[Tensor, Tensor]
    crops: tuple[Tensor, Tensor]


class _Way(NamedTuple):
    """One direction of a pair: the flow at each iteration, and the visibility of each pixel."""

    flows: list[Tensor]
    visible: list[Tensor]


class Brightflow(LabelFree):
    """The objective of Marsal et al., WACV 2023. Flow is predicted on augmented frames; photometric loss and smoothness
    use plain frames, the corrector's loss uses augmented ones. Every term is the mean over the pairs and both
    directions.
    """

    def __init__(self, network: TrainedNetwork, recipe: Recipe, settings: BrightflowObjective) -> None:
        super().__init__(network, recipe)
        self._settings = settings

    def forward(self, batch: Batch, step: TrainingStep) -> tuple[Tensor, dict[str, Tensor]]:
        """Compute the loss, see `LabelFree.forward`."""
        assert batch.whole is not None, "the loader must provide the uncropped frames"
        assert batch.plain is not None, "the loader must provide the frames in their original colours"
        settings, place = self._settings, batch.whole
        augmented = _Frames((place.image1, place.image2), (batch.image1, batch.image2))
        crops = batch.plain.crops(*batch.image1.shape[2:])
        plain = _Frames((batch.plain.image1, batch.plain.image2), crops)
        ways = self._ways(augmented, place)
        sources, numbers = plain.whole, {}
        if settings.corrector > 0 and step.progress >= settings.corrector_from:
            numbers["corrector"] = _mean(self._correction(frame, augmented, ways, place) for frame in (0, 1))
            if step.progress >= settings.corrected_from:
                sources = (self._corrected(0, plain, ways, place), self._corrected(1, plain, ways, place))
        numbers["photometric"] = settings.census * _mean(
            _census(plain.crops[frame], sources[1 - frame], ways[frame], place) for frame in (0, 1)
        )
        numbers["smoothness"] = _mean(self._smoothness(plain.crops[frame], ways[frame]) for frame in (0, 1))
        loss = numbers["photometric"] + settings.smooth * numbers["smoothness"]
        if "corrector" in numbers:
            loss = loss + settings.corrector * numbers["corrector"]
        weight = self._self_supervision(step)
        if weight:
            numbers["self_supervision"] = self._students(batch, plain)
            loss = loss + weight * numbers["self_supervision"].clamp(0, FARTHEST)
        return loss, {"flow": ways[0].flows[-1], **numbers}

    def _ways(self, frames: _Frames, place: WholeFrames) -> tuple[_Way, _Way]:
        there, back = self._flows(*frames.crops)

        def way(own: list[Tensor], opposite: list[Tensor]) -> _Way:
            visible = [
                visibility(flow, other, place.corners, place.sizes, self._settings.occlusion)
                for flow, other in zip(own, opposite, strict=True)
            ]
            return _Way(own, visible)

        return way(there, back), way(back, there)

    def _flows(self, first: Tensor, second: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        there, back = self.both(self.images(first), self.images(second))
        return [flow.float() for flow in there], [flow.float() for flow in back]

    def _offsets(self, frame: int, frames: _Frames, ways: tuple[_Way, _Way], place: WholeFrames) -> Tensor:
        """Return the corrector's offsets for the crops of a frame (0 or 1), (N, 3, H, W), in grey levels; no gradient
        is propagated to the flows."""
        assert self.network.corrector is not None
        flow, visible = ways[frame].flows[-1].detach(), ways[frame].visible[-1]
        warped = _warped(frames.whole[1 - frame], flow, place)
        images = torch.cat((self.images(frames.crops[frame]), self.images(warped), visible), dim=1)
        with self.autocast(images):
            offsets: Tensor = self.network.corrector(images)
        return 255 * offsets.float()

    def _correction(self, frame: int, frames: _Frames, ways: tuple[_Way, _Way], place: WholeFrames) -> Tensor:
        """Return the corrector's loss for a frame (0 or 1), which is corrected and warped to the other frame."""
        other = 1 - frame
        offsets = self._offsets(frame, frames, ways, place) * ways[frame].visible[-1]
        corrected = with_offsets(frames.whole[frame], offsets, place.corners)
        warped = _warped(corrected, ways[other].flows[-1].detach(), place)
        return correction_loss(frames.crops[other], warped, ways[other].visible[-1])

    @torch.no_grad()
    def _corrected(self, frame: int, frames: _Frames, ways: tuple[_Way, _Way], place: WholeFrames) -> Tensor:
        """Return an uncropped frame (0 or 1) with the offsets of its crop added where they reduce the difference."""
        other, whole, flow = 1 - frame, frames.whole[frame], ways[1 - frame].flows[-1]
        offsets = self._offsets(frame, frames, ways, place)
        everywhere = with_offsets(whole, offsets, place.corners).clamp(0, 255)
        warped, corrected = _warped(whole, flow, place), _warped(everywhere, flow, place)
        improves = kept_offsets(frames.crops[other], warped, corrected, flow) * ways[frame].visible[-1]
        return with_offsets(whole, offsets * improves, place.corners).clamp(0, 255)

    def _smoothness(self, image: Tensor, way: _Way) -> Tensor:
        second_order = self._settings.second_order
        return over_iterations([robust_smoothness(flow, image, ALPHA, second_order) for flow in way.flows])

    def _self_supervision(self, step: TrainingStep) -> float:
        """Return the weight of the self-supervision, which is 0 at first and then increases."""
        begins, ends = self._settings.self_supervision_from, self._settings.self_supervision_to
        risen = (step.progress - begins) / max(ends - begins, 1e-9)
        return self._settings.self_supervision * min(max(risen, 0.0), 1.0)

    def _students(self, batch: Batch, plain: _Frames) -> Tensor:
        """Return the loss of the student's flows on frames without their border; the teacher is the network itself,
        applied to the plain crops."""
        assert batch.changed is not None, "the loader must provide the frames without their borders"
        with torch.no_grad():
            teachers = self._flows(*plain.crops)
        students = self._flows(*batch.changed)
        return _mean(
            self_supervised(student, teacher[-1], self._settings.border)
            for student, teacher in zip(students, teachers, strict=True)
        )


def _census(image: Tensor, source: Tensor, way: _Way, place: WholeFrames) -> Tensor:
    """Return the census distance between the crops (N, 3, H, W) of one frame and the uncropped other frame, sampled
    along the flow of each iteration."""
    return over_iterations(
        [
            masked_census(image, _warped(source, flow, place), visible)
            for flow, visible in zip(way.flows, way.visible, strict=True)
        ]
    )


def _warped(source: Tensor, flow: Tensor, place: WholeFrames) -> Tensor:
    return dilated_warp(source, flow, place.corners, place.sizes)[0]


def _mean(both: Iterable[Tensor]) -> Tensor:
    first, second = both
    return (first + second) / 2
