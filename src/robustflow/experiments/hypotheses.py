"""The hypotheses of the experiment, specified before any network was trained.

For each seed, one network is trained from random weights without corruptions. Each arm continues training from this
network with its corruptions; "plain" uses none. There is one hypothesis for each of the two held-out families: compared
with training without corruptions, training with all other families changes the error caused by the held-out family
(CRE, mean over the family's corruptions, severity 3). Both hypotheses are tested two-sided on held-out flying shapes,
over pairs and seeds, with Holm's correction for two tests at the 5 % level. RCRE is secondary; all other results (EPE,
CREr, clean EPE, single corruptions, the arm trained with all families) are descriptive.

A seed is excluded with all its arms in only two cases: if one of its networks has not been trained, or if the clean
error of one of them is not below half the error of zero flow, which means that the network has not learned to match.
"""

from __future__ import annotations

from dataclasses import dataclass

from .arms import LEFT_OUT


@dataclass(frozen=True)
class Hypothesis:
    """The hypothesis that training with all families except one changes an error under the held-out family."""

    family: str
    quantity: str = "cre"

    @property
    def arm(self) -> str:
        """Return the arm that is compared with training without corruptions."""
        return f"no_{self.family}"


PRIMARY = tuple(Hypothesis(family) for family in LEFT_OUT)
SECONDARY = tuple(Hypothesis(family, "rcre") for family in LEFT_OUT)
DATASET = "shapes"
"""Dataset on which the hypotheses are tested."""
LEVEL = 0.05
"""Joint significance level of the two primary tests."""
