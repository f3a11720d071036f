"""Compute EPE, Fl-all and RCRE from plain arrays, one image at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError
from ..core.types import Flow, unmasked
from .error_maps import FL_PIXELS, FL_SHARE, epe_map, error_sum, magnitude_map


def epe(flow: Any, truth: Any, valid: Any = None) -> float | None:
    """Return the mean end-point error of one image, in pixels.

    Args:
        flow, truth: predicted and ground-truth flow in pixels, (H, W, 2) arrays or tensors of any floating dtype.
        valid: (H, W) mask of the pixels to average over, bool or numbers (0 is False); all pixels by default.

    Returns:
        The mean error, or None if there are no pixels to average over. Pixels where either flow is masked or not
        finite are excluded from the average; check for them with `np.isfinite` first, as `evaluate` does.

    Raises:
        DataError: a wrong dtype or shape, or shapes that differ.

    >>> import numpy as np
    >>> epe(np.full((2, 2, 2), 3.0), np.full((2, 2, 2), [0.0, -1.0]))
    5.0
    """
    errors = epe_map(_flow(flow), _flow(truth))
    return _mean(errors, valid)


def fl_all(flow: Any, truth: Any, valid: Any = None) -> float | None:
    """Return the percentage of outliers in one image: error > 3 px and > 5 % of the ground-truth flow magnitude.

    This is the definition of KITTI 2015. Arguments, exceptions and the meaning of None are the same as for `epe`.

    >>> import numpy as np
    >>> truth = np.zeros((1, 4, 2))
    >>> fl_all(truth + [[[0, 0], [0, 3], [3, 4], [6, 8]]], truth)
    50.0
    """
    true = _flow(truth)
    errors = epe_map(_flow(flow), true)
    outliers = (errors > FL_PIXELS) & (errors > FL_SHARE * magnitude_map(true))
    share = _mean(np.where(np.isnan(errors), np.nan, outliers), valid)
    return None if share is None else 100.0 * share


def rcre(flow: Any, clean_flow: Any, valid: Any = None) -> float | None:
    """Return the Relative Corruption Robustness Error of one image, in pixels: the mean of |flow - clean_flow|.

    Args:
        flow, clean_flow: a model's flow on the corrupted frames and on the clean frames; types and shapes as in `epe`.
        valid: (H, W) mask of the pixels to average over, as in `epe`. If a sample has ground truth, the benchmarks pass
            the pixels with ground truth, as the reference code does.

    >>> import numpy as np
    >>> rcre(np.full((2, 2, 2), [3.0, 4.0]), np.zeros((2, 2, 2)))
    5.0
    """
    return epe(flow, clean_flow, valid)


def _numpy(array: Any) -> npt.NDArray[Any]:
    """Convert an array, or a tensor on any device, to a NumPy array."""
    if not hasattr(array, "detach"):
        return np.asarray(unmasked(array))
    tensor = array.detach().cpu()
    return np.asarray(tensor.float() if tensor.is_floating_point() else tensor)  # NumPy lacks bfloat16


def _flow(array: Any) -> Flow:
    values = _numpy(array)
    if not np.issubdtype(values.dtype, np.floating) or values.ndim != 3 or values.shape[2] != 2:
        raise DataError(
            "flow",
            f"it must be a floating-point array of shape (H, W, 2), not {values.dtype} {values.shape}; "
            "convert a tensor (2, H, W) with permute(1, 2, 0)",
        )
    return values.astype(np.float32)


def _mean(errors: npt.NDArray[np.float64], valid: Any) -> float | None:
    mask = None if valid is None else _numpy(valid) != 0
    if mask is not None and mask.shape != errors.shape:
        raise DataError(
            "valid", f"the mask has shape {mask.shape}, but the flow is {errors.shape}; both must be (H, W)"
        )
    n, total = error_sum(errors, mask)
    return total / n if n else None
