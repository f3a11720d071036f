"""Compute the paper's robustness metrics CRE, CREr and RCRE (section "Robustness Metrics").

CRE and CREr are computed from the mean errors over an image, a corruption or the complete run:

    CRE_{c,s} = EPE_{c,s} - EPE_clean            absolute robustness, pixels
    CREr      = CRE / EPE_clean                  relative robustness, dimensionless
    RCRE_{c,s} = |f_{c,s} - f_clean|             needs no ground truth, pixels (`of_arrays.rcre`)

CRE is negative if a corruption reduces the error, and RCRE >= |CRE| over the same pixels.
"""

from __future__ import annotations

import math


def cre(epe: float | None, epe_clean: float | None) -> float | None:
    """Return the Corruption Robustness Error, i.e. the increase in error, in pixels; None if either error is None."""
    return None if epe is None or epe_clean is None else epe - epe_clean


def crer(cre: float | None, epe_clean: float | None) -> float | None:
    """Return the Corruption Robustness Error ratio; None if the CRE is None or the clean error is exactly 0."""
    if cre is None or not epe_clean:
        return None
    ratio = cre / epe_clean
    return ratio if math.isfinite(ratio) else None
