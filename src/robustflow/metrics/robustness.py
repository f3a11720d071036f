"""The paper's robustness metrics: CRE, CREr and RCRE (section "Robustness Metrics").

CRE and CREr are computed from mean errors, whatever they are means over (an image, a corruption, all):

    CRE_{c,s} = EPE_{c,s} - EPE_clean            absolute robustness, pixels
    CREr      = CRE / EPE_clean                  relative robustness, no unit
    RCRE_{c,s} = |f_{c,s} - f_clean|             needs no ground truth, pixels (`of_arrays.rcre`)

so CRE may be negative (a corruption that helps), and RCRE >= |CRE| over the same pixels.
"""

from __future__ import annotations

import math


def cre(epe: float | None, epe_clean: float | None) -> float | None:
    """Corruption Robustness Error in pixels: how much the error grew. None if either error is None.

    >>> cre(2.5, 2.0)
    0.5
    """
    return None if epe is None or epe_clean is None else epe - epe_clean


def crer(cre: float | None, epe_clean: float | None) -> float | None:
    """Corruption Robustness Error ratio. None if it is not defined: no CRE, or a clean error of exactly 0.

    >>> crer(0.5, 2.0)
    0.25
    """
    if cre is None or not epe_clean:
        return None
    ratio = cre / epe_clean
    return ratio if math.isfinite(ratio) else None
