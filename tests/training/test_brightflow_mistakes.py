"""The comparison with the original code detects deliberate mistakes in BrightFlow's loss."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")


from robustflow.training.data.loader import Batch  # noqa: E402
from robustflow.training.losses import brightflow as losses  # noqa: E402
from robustflow.training.losses import dilated_warp, photometric, smoothness  # noqa: E402
from robustflow.training.unsupervised import brightflow as objective  # noqa: E402

from .brightflow_steps import LOSS, step  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]


def _unit_range(patch, given):
    real = smoothness.robust_smoothness
    patch(objective, "robust_smoothness", lambda flow, image, *rest: real(flow, image / 255, *rest))


def _half_smoothness(patch, given):
    real = smoothness.robust_smoothness
    patch(objective, "robust_smoothness", lambda *args: real(*args) / 2)


def _usual_grey(patch, given):
    patch(losses, "LUMA", photometric.LUMA)


def _last_mask(patch, given):
    real = objective._census
    patch(
        objective,
        "_census",
        lambda image, source, way, place: real(image, source, way._replace(visible=way.visible[-1:] * 3), place),
    )


def _one_quotient(patch, given):
    patch(losses, "masked_mean", lambda values, mask: (values * mask).sum() / mask.sum())


def _all_visible(patch, given):
    patch(objective, "visibility", lambda flow, *rest: torch.ones_like(flow[:, :1]))


def _hard_coverage(patch, given):
    real = losses.coverage
    patch(losses, "coverage", lambda flow, *values: (real(flow, *values) >= 0.2).float())


def _crop_is_all(patch, given):
    patch(losses, "leaves", lambda flow: torch.zeros_like(flow[:, :1]))


def _augmented_compared(patch, given):
    patch(given, "batch", Batch(**{**vars(given.batch), "plain": given.batch.whole}))


def _target_corrected(patch, given):
    def to_the_target(self, frame, frames, ways, place):
        flow, visible = ways[frame].flows[-1].detach(), ways[frame].visible[-1]
        warped = objective._warped(frames.whole[1 - frame], flow, place)
        offsets = self._offsets(frame, frames, ways, place) * visible
        return losses.correction_loss(frames.crops[frame] + offsets, warped, visible)

    patch(objective.Brightflow, "_correction", to_the_target)


def _half_offsets(patch, given):
    real = objective.Brightflow._offsets
    patch(objective.Brightflow, "_offsets", lambda *args: real(*args) / 2)


def _mean_of_colours(patch, given):
    patch(objective, "correction_loss", lambda *args: losses.correction_loss(*args) / 3)


def _clamped_correction(patch, given):
    patch(objective, "with_offsets", lambda *args: losses.with_offsets(*args).clamp(0, 255))


def _all_kept(patch, given):
    patch(objective, "kept_offsets", lambda target, warped, corrected, flow: torch.ones_like(flow[:, :1]))


def _kept_at_the_target(patch, given):
    patch(
        objective,
        "kept_offsets",
        lambda target, warped, corrected, flow: (
            (target - corrected).abs().mean(1, True) < (target - warped).abs().mean(1, True)
        ).float(),
    )


def _edge_pixels_not_black(patch, given):
    patch(dilated_warp, "inside_frame", lambda flow, *place: torch.ones_like(flow[:, :1]))


def _teacher_sees_augmented(patch, given):
    real = objective.Brightflow._students

    def students(self, batch, plain):
        return real(self, batch, plain._replace(crops=(batch.image1, batch.image2)))

    patch(objective.Brightflow, "_students", students)


def _half_self(patch, given):
    patch(objective, "self_supervised", lambda *args: losses.self_supervised(*args) / 2)


def _clamped_differences(patch, given):
    real = losses.charbonnier
    patch(losses, "charbonnier", lambda differences: real(differences).clamp(0, 10))


def _low_limit(patch, given):
    patch(objective, "FARTHEST", 50.0)


MISTAKES = [
    (_unit_range, "kitti", 0, "smooth", 5.0),
    (_unit_range, "sintel", 0, "smooth", 5.0),
    (_half_smoothness, "kitti", 0, "smooth", 0.4),
    (_usual_grey, "kitti", 0, "photo", 5e-4),
    (_last_mask, "kitti", 0, "photo", 3e-4),
    (_last_mask, "sintel", 0, "photo", 3e-5),
    (_one_quotient, "kitti", 0, "photo", 4e-4),
    (_one_quotient, "sintel", 0, "photo", 1.5e-5),
    (_all_visible, "kitti", 0, "photo", 2e-3),
    (_hard_coverage, "sintel", 0, "photo", 2e-5),
    (_crop_is_all, "kitti", 0, "photo", 2e-5),
    (_augmented_compared, "kitti", 0, "photo", 1e-3),
    (_augmented_compared, "kitti", 0, "smooth", 0.2),
    (_target_corrected, "kitti", 22000, "correc", 0.02),
    (_half_offsets, "kitti", 22000, "correc", 0.1),
    (_mean_of_colours, "kitti", 22000, "correc", 0.6),
    (_clamped_correction, "kitti", 22000, "correc", 1e-3),
    (_half_offsets, "sintel", 26000, "photo", 1e-3),
    (_all_kept, "kitti", 26000, "photo", 1e-3),
    (_kept_at_the_target, "kitti", 26000, "photo", 1e-3),
    (_edge_pixels_not_black, "kitti", 0, "photo", LOSS),
    (_teacher_sees_augmented, "kitti", 33750, "self", 0.01),
    (_half_self, "kitti", 33750, "self", 0.4),
    (_clamped_differences, "kitti", 33750, "self", 0.1),
    (_low_limit, "kitti", 33750, "loss_total", 0.1),
]


@pytest.mark.parametrize(
    ("mistake", "case", "number", "term", "least"),
    MISTAKES,
    ids=[f"{mistake.__name__.strip('_')}-{case}-{term}" for mistake, case, _, term, _ in MISTAKES],
)
def test_mistake_moves_the_term_beyond_its_tolerance(given, monkeypatch, mistake, case, number, term, least):
    mistake(monkeypatch.setattr, given)
    expected = given.cases["cases"][case]["steps"][str(number)][term]
    off = abs(step(given, case, number).terms[term] / expected - 1)
    assert off > least >= LOSS
