"""Does training with corruptions help against a family that was left out? (docs/robust-training.md)

    python bench/robust_training.py --output robust-training --seeds 6

For each seed, `tiny` is trained from random weights; four arms continue from these weights, on the same pairs: without
corruptions, with all families, without noise, without weather. Each network is measured on held-out flying shapes.
What is complete is not repeated. Prints differences from training without corruptions with 95 % intervals (Student's,
with the variances over seeds and over pairs added, Satterthwaite's degrees of freedom).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.stats import t

import robustflow as rf
from robustflow.corruptions import FAMILIES, IMAGE_PAIR

Array = np.ndarray[Any, np.dtype[np.float64]]
FAMILY = {
    family: [name for name in FAMILIES[family] if name in IMAGE_PAIR]
    for family in ("digital", "illumination", "weather", "noise", "blur")
}
LEFT_OUT = ("noise", "weather")
ARMS = {"plain": [], "all": [*FAMILY], **{f"no_{left}": [name for name in FAMILY if name != left] for left in LEFT_OUT}}
SEED_OF_ARMS = 1000
"""Offset of the seeds of the arms, so that they do not repeat the draws of the initial training."""


def train(folder: Path, recipe: str, seed: int, *options: str) -> Path:
    """Train `tiny`, or continue where it was interrupted; return the checkpoint."""
    last, complete = folder / "last.pth", folder / "complete"
    if not complete.exists():
        command = [sys.executable, "-m", "robustflow", "train", "tiny", "--recipe", recipe, "--seed", str(seed)]
        resume = ["--resume"] if last.exists() else []
        subprocess.run([*command, "-o", str(folder), "--save-every", "20", *options, *resume], check=True)
        complete.touch()
    return last


def errors(folder: Path, checkpoint: Path, given: argparse.Namespace) -> dict[str, Array]:
    """Measure a network; return its EPE and CRE under each left-out family, and its clean EPE, by pair."""
    rows = rf.evaluate(
        rf.load_model("tiny", checkpoint=checkpoint),
        "shapes",
        output=folder,
        corruptions=[name for family in LEFT_OUT for name in FAMILY[family]],
        severities=[3],
        data_options={"pairs": given.pairs, "size": given.size, "split": "test"},
    ).rows.with_columns(epe=pl.col("epe_sum") / pl.col("n_valid"))
    clean = rows.filter(corruption="clean").sort("sample")["epe"].to_numpy()
    found = {"clean EPE": clean}
    for family in LEFT_OUT:
        part = rows.filter(pl.col("corruption").is_in(FAMILY[family]))
        epe = part.group_by("sample").agg(pl.col("epe").mean()).sort("sample")["epe"].to_numpy()
        found |= {f"EPE under {family}": epe, f"CRE under {family}": epe - clean}
    return found


def interval(differences: Array) -> str:
    """Return the mean over seeds and pairs, float64 (seeds, pairs), and its interval if there are several of both."""
    mean = differences.mean()
    if min(differences.shape) < 2:
        return f"{mean:+.2f}"
    parts = [differences.mean(axis=axis).var(ddof=1) / differences.shape[1 - axis] for axis in (0, 1)]
    freedom = sum(parts) ** 2 / sum(
        part**2 / (count - 1) for part, count in zip(parts, differences.shape[::-1], strict=True)
    )
    reach = t.ppf(0.975, freedom) * np.sqrt(sum(parts))
    return f"{mean:+.2f} [{mean - reach:+.2f}, {mean + reach:+.2f}]"


def main() -> None:
    """Train, measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("robust-training"))
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--pairs", type=int, default=150)
    parser.add_argument("--size", default="160x224")
    parser.add_argument("--steps", type=int, help="updates of each training, instead of the recipes'")
    given = parser.parse_args()
    steps = [] if given.steps is None else ["--steps", str(given.steps)]
    measured: dict[str, list[dict[str, Array]]] = {arm: [] for arm in ARMS}
    for seed in range(given.seeds):
        folder = given.output / f"seed-{seed}"
        start = train(folder / "start", "small", seed, "--init", "random", *steps)
        for arm, families in ARMS.items():
            names = ",".join(name for family in families for name in FAMILY[family])
            corrupt = ["--corrupt", names] if names else []
            options = ["--init", str(start), "--init-trained-on", "FS:train", *corrupt, *steps]
            checkpoint = train(folder / arm, "small_robust", seed + SEED_OF_ARMS, *options)
            measured[arm].append(errors(folder / "runs" / arm, checkpoint, given))
    for quantity in measured["plain"][0]:
        plain = np.stack([one[quantity] for one in measured["plain"]])
        print(f"{quantity}: {plain.mean():.2f} px without corruptions")
        for arm in list(ARMS)[1:]:
            print(f"  {arm:12} {interval(np.stack([one[quantity] for one in measured[arm]]) - plain)}")


if __name__ == "__main__":
    main()
