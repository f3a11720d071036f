"""Attacks that cannot be run are refused with a one-line message."""

from __future__ import annotations

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, ModelError, UsageError

torch = pytest.importorskip("torch", reason="needs the torch extra")

from ..refusals import refused  # noqa: E402
from .small_attacks import attacked_pair  # noqa: E402
from .smooth_net import Given, random_pair, smooth_model  # noqa: E402


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"name": "pdg"}, UsageError, "unknown attack 'pdg': did you mean 'pgd'"),
        ({"norm": "l2"}, UsageError, "norm of attack pgd 'l2'"),
        ({"steps": 0}, UsageError, "steps of attack pgd must be an integer of at least 1, not 0"),
        ({"target": "up"}, UsageError, "target of attack pgd 'up'"),
        ({"name": "square", "norm": "rms"}, UsageError, "norm of attack square 'rms'"),
        ({"name": "pcfa", "moved": "joint"}, UsageError, "box=clipping"),
        ({"reference": "truth"}, UsageError, "the pair has none; pass flow="),
        ({"name": "pgd:steps=many"}, UsageError, "steps of attack pgd must be an integer of at least 1, not 'many'"),
        ({"name": "pgd:20"}, UsageError, "options of attack pgd are written option=value, not '20'"),
        ({"name": "transfer:dis"}, ModelError, "model 'dis' provides no gradient of its flow, which the attack apgd"),
        ({"name": "transfer:tny"}, UsageError, "unknown model 'tny'"),
        ({"name": "transfer:tiny:attack=transfer"}, UsageError, "another transfer; name only the inner model"),
        ({"name": "transfer:tiny:attack=pdg"}, UsageError, "unknown attack 'pdg'"),
        ({"name": "worst_of:pgd+pcfa"}, UsageError, "pgd has norm linf, pcfa has norm rms; .* must have the same norm"),
        ({"name": "worst_of:pgd:queries=3"}, UsageError, "unknown option of the attacks in worst_of 'queries'"),
        ({"name": "worst_of:worst_of:pgd"}, UsageError, "cannot contain another worst_of; name all parts: worst_of:A"),
        ({"name": "transfer:tiny:attack=worst_of"}, UsageError, "worst_of:transfer"),
        ({"budget": 0}, UsageError, "more than 0 and at most 255 grey levels"),
        ({"budget": "8"}, UsageError, "at most 255 grey levels, not '8'"),
        ({"budget": float("nan")}, UsageError, "at most 255 grey levels, not nan"),
        ({"severity": 2.5}, UsageError, "severity 2.5 does not exist"),
        ({"flow": [[1, 2]]}, DataError, r"ground truth is list; expected float32 \(8, 10, 2\)"),
        ({"flow": np.full((8, 10, 2), np.nan, np.float32)}, DataError, "NaN or infinite at valid pixels"),
        ({"name": "pgd:steps=3:steps=4"}, UsageError, "'pgd:steps=3:steps=4' sets the option steps twice"),
        ({"name": "worst_of", "parts": []}, UsageError, "give its parts by their names"),
        ({"name": "patch", "severity": 1}, DataError, r"0.1 % of 8x10 pixels is smaller than one pixel"),
        (
            {"flow": np.zeros((8, 10, 2), np.float32), "valid": [[1]]},
            DataError,
            r"mask is list; expected bool \(8, 10\)",
        ),
        ({"budget": 3, "severity": 2}, UsageError, "not both"),
        ({"valid": np.ones((8, 10), bool)}, UsageError, "pass flow= as well"),
        ({"flow": np.zeros((3, 4, 2), np.float32)}, DataError, r"ground truth is float32 \(3, 4, 2\)"),
        ({"flow": np.zeros((8, 10, 2), np.float32), "valid": np.zeros((8, 10), bool)}, UsageError, "no valid pixels"),
    ],
)
def test_invalid_frames_or_options_are_refused_in_one_line(change, error, message):
    with refused(error, message):
        rf.attack(*random_pair(), smooth_model(), **{"name": "pgd", **change})


class Failing(torch.autograd.Function):
    """A copy operation whose gradient cannot be computed."""

    @staticmethod
    def forward(ctx, images):
        return images.clone()

    @staticmethod
    def backward(ctx, gradient):
        raise RuntimeError("no\nbackward")


def _out_of_memory(images1, images2):
    if images1.requires_grad:
        raise RuntimeError("out of memory\nhere")
    return images1[:, :2]


_LEARNED = torch.nn.Parameter(torch.zeros(1))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda images1, images2: images1[:, :2].detach(), "a flow without a gradient"),
        (lambda images1, images2: images1[:, :2].detach() + _LEARNED, "does not depend on the images"),
        (lambda images1, images2: images1[:, :2] if not images1.requires_grad else None, "returned NoneType"),
        (lambda images1, images2: images1[:, :2] if not images1.requires_grad else (1,), "returned tuple"),
        (_out_of_memory, "raised RuntimeError on .*in its method differentiable: out of memory"),
        (
            lambda images1, images2: Failing.apply(images1)[:, :2],
            "raised RuntimeError on .*in its method differentiable",
        ),
    ],
)
def test_a_model_whose_gradient_cannot_be_used_is_refused_in_one_line(function, message):
    with refused(ModelError, message):
        attacked_pair("pgd", Given(function))
