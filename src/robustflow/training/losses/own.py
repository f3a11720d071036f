"""Support losses defined by a user's network."""

from __future__ import annotations

import torch
from torch import Tensor

from ...errors import UsageError


def checked_loss(returned: object) -> tuple[Tensor, dict[str, float]]:
    """Check the return value of a network's `loss`: a scalar tensor, or a scalar tensor and a dictionary of values for
    the log.

    Raises:
        UsageError: the value has any other form.

    >>> checked_loss((torch.ones(()), {"photometric": torch.tensor(2.0)}))
    (tensor(1.), {'photometric': 2.0})
    """
    loss, numbers = returned if isinstance(returned, tuple) and len(returned) == 2 else (returned, {})
    if not isinstance(loss, Tensor) or loss.numel() != 1 or not isinstance(numbers, dict):
        raise UsageError(
            f"the network's method loss(batch) returned {type(returned).__name__}; return a scalar tensor, or a scalar "
            "tensor and a dictionary of numbers for the log"
        )
    return loss.reshape(()), {str(name): float(torch.as_tensor(value).detach()) for name, value in numbers.items()}
