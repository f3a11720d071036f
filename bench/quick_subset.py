"""How few corruptions rank models as all 20 of KITTI-FC do? From the paper's tables, without a run.

    python bench/quick_subset.py [--largest 16]

For each number of corruptions, the set whose means rank the 29 published variants most nearly as the means over all 20:
the smallest of Kendall's tau of EPE, CRE and RCRE is maximised, greedily and by exchanges. Then a trial for each
variant: the set is chosen without it, and tau is over all variants. A set that can replace the full run should
reach 0.95 in 95 % of these trials. The tables hold means over severities and pairs, so that neither can be chosen from
them. The set of 15 is `benchmarks/kitti_fc.py:KittiFC.facts.quick`.
"""

from __future__ import annotations

import argparse

import numpy as np

from robustflow.analysis.published.tables import published_results
from robustflow.corruptions.registry import IMAGE_PAIR

METRICS = ("epe", "cre", "rcre")
WANTED = 0.95


class Ranking:
    """The published errors, and how well means over fewer corruptions keep the ranking by all."""

    def __init__(self) -> None:
        lines = [line for line in published_results() if line.benchmark == "kitti-fc"]
        self.models = [f"{line.name} ({line.setting})" for line in lines]
        self._errors = np.array(
            [[[line.number(metric, name) for name in IMAGE_PAIR] for line in lines] for metric in METRICS], float
        )
        self.pairs = np.triu_indices(len(lines), 1)
        self._full = self._order(range(len(IMAGE_PAIR)))

    def _order(self, chosen: range | list[int]) -> np.ndarray:
        means = self._errors[:, :, list(chosen)].mean(-1)
        return np.sign(means[:, self.pairs[0]] - means[:, self.pairs[1]])

    def taus(self, chosen: list[int], without: int = -1) -> np.ndarray:
        """Kendall's tau (a) of each metric, over all models but one."""
        kept = (self.pairs[0] != without) & (self.pairs[1] != without)
        return (self._order(chosen) * self._full)[:, kept].mean(1)

    def best(self, count: int, without: int = -1) -> list[int]:
        """A set of `count` corruptions with a high smallest tau: one after the other, then exchanged while it helps."""

        def quality(chosen: list[int]) -> tuple[float, float]:
            taus = self.taus(chosen, without)
            return float(taus.min()), float(taus.sum())

        every, chosen = range(len(IMAGE_PAIR)), list[int]()
        while len(chosen) < count:
            chosen.append(max((one for one in every if one not in chosen), key=lambda one: quality([*chosen, one])))
        while True:
            exchanged = [
                [*chosen[:place], one, *chosen[place + 1 :]]
                for place in range(count)
                for one in every
                if one not in chosen
            ]
            better = max(exchanged, key=quality, default=chosen)
            if quality(better) <= quality(chosen):
                return sorted(chosen)
            chosen = better


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smallest", type=int, default=6)
    parser.add_argument("--largest", type=int, default=16)
    options = parser.parse_args()
    ranking = Ranking()
    print(f"{len(ranking.models)} variants; tau of {', '.join(METRICS)}; share of trials with every tau >= {WANTED}")
    for count in range(options.smallest, options.largest + 1):
        chosen = ranking.best(count)
        taus = " ".join(f"{tau:.3f}" for tau in ranking.taus(chosen))
        trials = [ranking.taus(ranking.best(count, without)).min() for without in range(len(ranking.models))]
        share = np.mean(np.array(trials) >= WANTED)
        names = ", ".join(IMAGE_PAIR[one] for one in chosen)
        print(f"{count:2d}  {taus}  {100 * share:3.0f} % (least {min(trials):.3f})  {names}", flush=True)


if __name__ == "__main__":
    main()
