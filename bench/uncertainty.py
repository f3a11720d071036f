"""Measure how far intervals cover and tests reject: the tables of docs/design/uncertainty.md.

    python bench/uncertainty.py                    simulated errors
    python bench/uncertainty.py RUN RUN RUN ...    also images of these runs (on the same data), drawn with replacement

Simulated errors of an image are scene x model, log-normal; "spread" is the standard deviation of the logarithm of a
model's errors. Images that are drawn twice count as different images, so that the truth is the mean of the runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from itertools import permutations
from typing import Any

import numpy as np
import polars as pl

from robustflow import load_run
from robustflow.data.datasets.kitti import drive_groups
from robustflow.data.datasets.split import KITTI_KEYS, kitti_split
from robustflow.stats.inference import INCREASE_FLOOR, Scores, flip_test, mean_interval, ratio_interval, ratio_of_means

Array = np.ndarray[Any, np.dtype[np.float64]]
IMAGES = (8, 15, 30, 80)
RNG = np.random.default_rng(0)


def scores(values: Array) -> Scores:
    """Give each image the same share."""
    count = values.shape[-1]
    return Scores(values / count, np.full(count, 1 / count))


def covered(ends: tuple[Array, Array], truth: float) -> str:
    """Return the percentage of samples whose interval contains the truth."""
    return f"{100 * np.mean((ends[0] <= truth) & (truth <= ends[1])):5.1f}"


def student(values: Array) -> tuple[Array, Array]:
    """Return Student's interval."""
    from scipy.stats import t

    reach = t.ppf(0.975, values.shape[-1] - 1) * values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])
    return values.mean(axis=-1) - reach, values.mean(axis=-1) + reach


def normal(spread: float, *shape: int) -> Array:
    """Draw log-normal factors with the mean 1."""
    return np.exp(RNG.normal(0, spread, shape) - spread**2 / 2)


def simulated_errors(spread: float, samples: int, images: int) -> tuple[Array, Array, Array, tuple[float, float]]:
    """Draw clean errors, corrupted errors that grew by a factor, additive increases, and the true means of the clean
    error and of the increases."""
    clean = normal(spread, samples, images)
    return clean, 1.5 * clean * normal(0.3, samples, images), normal(0.5, samples, images), (1.0, 0.5)


def of_drives(values: Array) -> Scores:
    """Give each drive of KITTI-FC's 80 pairs the sum of its pairs."""
    pairs = kitti_split(KITTI_KEYS).evaluation
    drives = np.unique([drive_groups("kitti2015")[key] for key in pairs], return_inverse=True)[1]
    member = drives == np.arange(drives.max() + 1)[:, None]
    return Scores(values @ member.T / len(pairs), member.sum(axis=1) / len(pairs))


def drives(samples: int) -> Iterator[str]:
    """Yield coverage and rejections over KITTI-FC's drives, in which 60 % of the variance of the logarithm is."""
    size = len(of_drives(np.ones(80)).den)
    groups = np.argmax(of_drives(np.eye(80)).num > 0, axis=1)
    for spread in (0.5, 0.8, 1.1):
        scene = normal(spread * 0.6**0.5, samples, size)[:, groups] * normal(spread * 0.4**0.5, samples, 80)
        first, second = (scene * normal(0.3, samples, 80) for _ in range(2))
        parts = np.array_split(of_drives(first - second).num, 8)
        rejected = 100 * np.mean(np.concatenate([flip_test(part) for part in parts]) <= 0.05)
        ends = covered(mean_interval(of_drives(first)), 1.0), covered(mean_interval(scores(first)), 1.0)
        yield f"{spread:<6} EPE over drives {ends[0]}, over pairs {ends[1]}; equal models rejected {rejected:.1f}"


def coverage(samples: int) -> Iterator[str]:
    """Yield the coverage of intervals of one model on simulated errors."""
    yield f"{'spread images':14}" + "".join(f"{name:>11}" for name in ("EPE", "CRE x", "CREr x", "CREr +", "Student"))
    for spread in (0.5, 0.8, 1.1, 1.35):
        for images in (6, *IMAGES):
            clean, grown, added, (mean, growth) = simulated_errors(spread, samples, images)
            increase = scores(grown - clean)
            cells = (
                covered(mean_interval(scores(clean)), mean),
                covered(mean_interval(increase, floor=INCREASE_FLOOR), growth),
                covered(ratio_interval(increase, scores(clean)), growth),
                covered(ratio_interval(scores(added), scores(clean)), 1.0),
                covered(student(clean), mean),
            )
            yield f"{spread:<6} {images:<7}" + "".join(f"{cell:>11}" for cell in cells)


def real_coverage(name: str, of_image: dict[str, Array], samples: int) -> Iterator[str]:
    """Yield the coverage of intervals on images of a run, and the width of that of CRE beside Student's."""
    for images in (6, *IMAGES[:3]):
        drawn = RNG.integers(0, len(of_image["clean"]), (samples, images))
        cells = []
        for key, values in of_image.items():
            one = scores(values[drawn])
            options: dict[str, Any] = {"bounded": key in ("fl", "wauc")} | (
                {"floor": INCREASE_FLOOR} if key == "cre" else {}
            )
            ends = mean_interval(one, **options)
            cells.append(f"{key} {covered(ends, values.mean())}")
            if key == "cre":
                plain = student(values[drawn])
                width = np.nanmedian((ends[1] - ends[0]) / (plain[1] - plain[0]))
                cells.append(f"(Student {covered(plain, values.mean())}, {width:.2f} x as wide)")
        truth = of_image["cre"].mean() / of_image["clean"].mean()
        cells.append(
            f"crer {covered(ratio_interval(scores(of_image['cre'][drawn]), scores(of_image['clean'][drawn])), truth)}"
        )
        yield f"{name:14} {images:<4}" + "  ".join(cells)


Pair = Callable[[int, int], tuple[Array, Array]]


def simulated_pairs(spread: float) -> dict[str, Pair]:
    """Return how the errors of two models are drawn, by name; the first two have equal means."""

    def pair(first: float, second: float, ratio: float = 1.0, blow_ups: float = 0.0) -> Pair:
        def draw(samples: int, images: int) -> tuple[Array, Array]:
            scene = normal(spread, samples, images)
            one, other = (scene * normal(own, samples, images) for own in (first, second))
            if blow_ups:
                other = other * np.where(RNG.random(other.shape) < blow_ups, 10, 1) / (1 + 9 * blow_ups)
            return one, ratio * other

        return draw

    return {
        "equal, exchangeable": pair(0.3, 0.3),
        "equal, unequal spread": pair(0.1, 0.8),
        "equal, 4 % blow-ups": pair(0.1, 0.1, blow_ups=0.04),
        "B = 1.3 A": pair(0.2, 0.2, 1.3),
        "B = 2 A": pair(0.2, 0.2, 2.0),
    }


def real_pairs(first: Array, second: Array) -> dict[str, Pair]:
    """Return draws of images of two runs: with exchanged models, with equal means, and as they are."""

    def drawn(one: Array, other: Array, swap: bool = False) -> Pair:
        def draw(samples: int, images: int) -> tuple[Array, Array]:
            at = RNG.integers(0, len(one), (samples, images))
            pair = one[at], other[at]
            if not swap:
                return pair
            turned = RNG.random(at.shape) < 0.5
            return np.where(turned, *pair), np.where(turned, *pair[::-1])

        return draw

    level = second * first.mean() / second.mean()
    return {
        "exchanged": drawn(first, second, swap=True),
        "equal means": drawn(first, level),
        "x 1.3": drawn(first, 1.3 * level),
        "x 2": drawn(first, 2 * level),
        "as measured": drawn(first, second),
    }


def rejections(
    pairs: dict[str, Pair], truths: dict[str, tuple[float, float]], samples: int, images: tuple[int, ...]
) -> Iterator[str]:
    """Yield how often tests reject at 5 %, and the coverage of the interval of the difference and of the ratio."""
    from scipy.stats import ttest_rel, wilcoxon

    for count in images:
        for kind, draw in pairs.items():
            first, second = draw(samples, count)
            differences = first - second
            step = max(1, 2**24 // 10_000)
            p = np.concatenate([flip_test(differences[at : at + step]) for at in range(0, samples, step)])
            others = ttest_rel(first, second, axis=1).pvalue, wilcoxon(differences, axis=1).pvalue
            rates = "".join(f"{100 * np.mean(one <= 0.05):9.1f}" for one in (p, *others))
            mean, ratio = truths[kind]
            of_difference = covered(mean_interval(scores(differences)), mean)
            found = [ratio_of_means(first[row], second[row]) for row in range(min(samples, 300))]
            ends = np.array([pair for pair in found if pair is not None]).reshape(-1, 2)
            of_ratio = covered((ends[:, 0], ends[:, 1]), ratio) if len(ends) else "-"
            yield f"{count:<5}{kind:24}{rates}   difference {of_difference}   ratio {of_ratio}"


def per_image(folder: str) -> dict[str, Array]:
    """Return the clean EPE of each image of a run, and its means over corruptions."""
    share = pl.col("n_valid")
    rows = load_run(folder).rows.select(
        "sample",
        "corruption",
        epe=pl.col("epe_sum") / share,
        before=pl.col("clean_epe_sum") / share,
        rcre=pl.col("rcre_sum") / share,
        fl=100 * pl.col("fl_count") / share,
        wauc=100 * pl.col("wauc_sum") / share,
    )
    clean = rows.filter(corruption="clean").sort("sample")["epe"].to_numpy()
    corrupted = rows.filter(pl.col("corruption") != "clean").with_columns(cre=pl.col("epe") - pl.col("before"))
    means = corrupted.group_by("sample").agg(pl.col("epe", "cre", "rcre", "fl", "wauc").mean()).sort("sample")
    return {"clean": clean, **{name: means[name].to_numpy() for name in ("epe", "cre", "rcre", "fl", "wauc")}}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*")
    parser.add_argument("--samples", type=int, default=2000)
    given = parser.parse_args()
    print("Coverage of 95 % intervals, per cent; x: errors grow by a factor, +: by an independent amount")
    for line in coverage(given.samples):
        print(line, flush=True)
    print("\nKITTI-FC's 30 drives of 80 pairs")
    for line in drives(given.samples):
        print(line, flush=True)
    print("\nRejections at 5 %, per cent: flip test, Student's, Wilcoxon's; and coverage of the intervals")
    simulated = simulated_pairs(1.15)
    truths = dict.fromkeys(simulated, (0.0, 1.0)) | {"B = 1.3 A": (-0.3, 1 / 1.3), "B = 2 A": (-1.0, 0.5)}
    for line in rejections(simulated, truths, given.samples, IMAGES):
        print(line, flush=True)
    of_run = {folder: per_image(folder) for folder in given.runs}
    for folder, of_image in of_run.items():
        for line in real_coverage(folder, of_image, given.samples):
            print(line, flush=True)
    for one, other in permutations(of_run, 2):
        for key in ("epe", "cre"):
            first, second = of_run[one][key], of_run[other][key]
            pairs = real_pairs(first, second)
            mean = first.mean()
            level = second * mean / second.mean()
            means = {
                "x 1.3": (mean - 1.3 * mean, 1 / 1.3),
                "x 2": (-mean, 0.5),
                "as measured": (mean - second.mean(), mean / second.mean()),
            }
            print(f"{one} - {other}, {key}, scaled spread of ln {np.log(np.abs(level)).std(ddof=1):.2f}")
            for line in rejections(pairs, dict.fromkeys(pairs, (0.0, 1.0)) | means, given.samples, IMAGES[:3]):
                print(line, flush=True)


if __name__ == "__main__":
    main()
