"""What the experiment asks, written down before any of its networks was trained.

For each seed one network is trained from random weights without corruptions, and each arm continues from it with its
corruptions, "plain" without any. Two hypotheses, one for each family left out: training with all other families changes
the error that the family adds (CRE, mean over the family's corruptions, severity 3) against training without
corruptions. Both are tested two-sided on held-out flying shapes, over pairs and seeds, with Holm's correction for two
tests at the 5 % level. RCRE is secondary; everything else (EPE, CREr, clean EPE, single corruptions, the arm trained
with all) is description.

A seed is left out whole, with all of its arms, in two cases only: one of its networks has not been trained, or one of
them has a clean error that is not below half of zero flow's (it has not learned to match).
"""

from __future__ import annotations

from dataclasses import dataclass

from .arms import LEFT_OUT


@dataclass(frozen=True)
class Hypothesis:
    """Training with all families but one changes an error under the family left out.

    Attributes:
        family: the one left out.
        quantity: "cre" or "rcre".
    """

    family: str
    quantity: str = "cre"

    @property
    def arm(self) -> str:
        """The arm that is compared with training without corruptions."""
        return f"no_{self.family}"


PRIMARY = tuple(Hypothesis(family) for family in LEFT_OUT)
SECONDARY = tuple(Hypothesis(family, "rcre") for family in LEFT_OUT)
DATASET = "shapes"
"""The data set that they are tested on."""
LEVEL = 0.05
"""Significance level of the two primary tests together."""
