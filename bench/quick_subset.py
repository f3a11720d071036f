"""Find the smallest sets of corruptions, severities and pairs that rank models in the same way as the full KITTI-FC.

    python bench/quick_subset.py measure ERRORS.npz --data kitti2015=DIR --data kitti2012=DIR --data middlebury=DIR
    python bench/quick_subset.py choose ERRORS.npz

`measure` runs the methods that do not need a download (presets of DIS and Farneback, DIS-RGB, the shipped networks, and
some of these on filtered frames) under every corruption at every severity. The 80 pairs, reduced in size, are taken
from the given datasets, the demo and flying shapes. Results are saved after every pair, and the command can be stopped
early, because fewer pairs are also sufficient.

`choose` searches for the smallest set of conditions that preserves two rankings: that of these methods, by EPE, CRE and
RCRE over all conditions and pairs, and that of the 29 published variants within their settings (OOD, ID), whose tables
contain means over severities and pairs. A set consists of some corruptions at some severities. Its quality is the
smallest Kendall's tau (a) over the three metrics and the rankings. For each number of severities, corruptions are
removed one by one, then swapped as long as that improves the set. A set is printed if no smaller one is as good, with
trials: as many corruptions are chosen for half of the published method families, and tau is computed for the others.

**Pairs.** The pairs of KITTI-FC are not among the measured ones, so only their number can be chosen. The last lines of
the output show how using a fraction of the pairs changes the ranking when all corruptions and severities are kept.

The result is stored in `benchmarks/kitti_fc.py:KittiFC.facts.quick`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from robustflow.core.arguments import SEVERITIES
from robustflow.core.types import Flow, Frame, Sample
from robustflow.corruptions import corrupt
from robustflow.corruptions.registry import IMAGE_PAIR
from robustflow.data.datasets import load_dataset
from robustflow.metrics.error_maps import epe_map
from robustflow.models import load_model
from robustflow.stats.lines import LineKey
from robustflow.stats.published.tables import method_of, published_lines

METRICS = ("epe", "cre", "rcre")
WANTED = 0.95
PAIRS = 80
DRAWS = 200
SPLITS = 12
Predict = Callable[[Frame, Frame], Flow]


@dataclass(frozen=True)
class Population:
    """Models whose ranking a subset should preserve.

    Attributes:
        errors: mean EPE, CRE and RCRE under each corruption at the chosen severities, float64 (3, models, 20), in
            pixels.
        full: mean errors over all severities, same shape and unit.
    """

    errors: np.ndarray
    full: np.ndarray

    def tau(self, chosen: Sequence[int]) -> float:
        """The smallest tau of the three metrics between the rankings by the chosen corruptions and by all."""
        first, second = np.triu_indices(self.errors.shape[1], 1)
        means, full = self.errors[:, :, list(chosen)].mean(-1), self.full.mean(-1)
        orders = np.sign(means[:, first] - means[:, second]) * np.sign(full[:, first] - full[:, second])
        return float(orders.mean(1).min())


def quality(populations: Sequence[Population], chosen: Sequence[int]) -> tuple[float, float]:
    """The smallest tau, then the sum of all."""
    taus = [each.tau(chosen) for each in populations]
    return min(taus), sum(taus)


def best(populations: Sequence[Population], count: int) -> list[int]:
    """Find `count` corruptions whose ranking agrees well with the ranking by all corruptions."""

    def of(chosen: list[int]) -> tuple[float, float]:
        return quality(populations, chosen)

    every = range(len(IMAGE_PAIR))
    chosen = list(every)
    while len(chosen) > count:
        chosen = max(([one for one in chosen if one != lost] for lost in chosen), key=of)
    while True:
        exchanged = [
            [*chosen[:place], one, *chosen[place + 1 :]] for place in range(count) for one in every if one not in chosen
        ]
        better = max(exchanged, key=of, default=chosen)
        if of(better) <= of(chosen):
            return sorted(chosen)
        chosen = better


def published(families: Collection[str] | None = None) -> list[Population]:
    """The published variants of each setting with learned models, of all method families or of some."""
    populations = []
    for setting in ("OOD", "ID"):
        lines = [
            line
            for key, line in published_lines().items()
            if (key.benchmark, key.setting) == ("kitti-fc", setting) and (not families or family(key) in families)
        ]
        means = [[[line.number(metric, name) for name in IMAGE_PAIR] for line in lines] for metric in METRICS]
        populations += [Population(np.array(means, float), np.array(means, float))] if len(lines) > 1 else []
    return populations


def family(key: LineKey) -> str:
    method = method_of(key.model)
    assert method is not None
    return method.method


def held_out(count: int) -> np.ndarray:
    """For halves of the published method families, the tau of `count` corruptions that were chosen for the others."""
    families = sorted({family(key) for key in published_lines() if key.setting in ("OOD", "ID")})
    rng, taus = np.random.default_rng(0), []
    for _ in range(SPLITS):
        half = {*rng.permutation(families)[: len(families) // 2].tolist()}
        for chosen_for, tested in ((half, {*families} - half), ({*families} - half, half)):
            corruptions = best(published(chosen_for), count)
            taus.append(quality(published(tested), corruptions)[0])
    return np.array(taus)


class Measured:
    """The results of `measure`.

    Args:
        path: file written by `measure`.
    """

    def __init__(self, path: Path) -> None:
        with np.load(path) as file:
            self.errors, self._clean, self.methods = file["errors"], file["clean"], file["methods"].tolist()

    def means(self, severities: Sequence[int], pairs: Sequence[int] | None = None) -> np.ndarray:
        """EPE, CRE and RCRE of the methods under each corruption, float64 (3, methods, 20)."""
        chosen = slice(None) if pairs is None else list(pairs)
        errors = self.errors[chosen][:, :, :, [level - 1 for level in severities]].mean((0, 3))
        epe, rcre = errors[..., 0], errors[..., 1]
        return np.stack([epe, epe - self._clean[chosen].mean(0)[:, None], rcre])


def choose(path: Path, most: int) -> None:
    """Print the best sets, their trials, and the effect of using fewer pairs."""
    measured, tables = Measured(path), published()
    full = measured.means(SEVERITIES)
    print(f"{full.shape[1]} methods on {len(measured.errors)} pairs; tau of these, of OOD and of ID variants")
    levels = {
        severities: (Population(measured.means(severities), full), *tables)
        for size in range(1, len(SEVERITIES) + 1)
        for severities in combinations(SEVERITIES, size)
    }

    sizes = [(size, count) for size in range(1, len(SEVERITIES) + 1) for count in range(10, len(IMAGE_PAIR) + 1)]
    reached = -1.0
    for size, count in sorted(sizes, key=lambda one: one[0] * one[1]):
        if size * count > most or reached >= WANTED:
            break
        sets = [(each, best(levels[each], count)) for each in levels if len(each) == size]
        severities, corruptions = max(sets, key=lambda one: quality(levels[one[0]], one[1]))
        taus = [each.tau(corruptions) for each in levels[severities]]
        if min(taus) <= reached:
            continue
        reached, trials = min(taus), held_out(count)
        print(
            f"{size * count:3d} conditions: severities {severities}, tau {', '.join(f'{tau:.3f}' for tau in taus)}; "
            f"for other families {trials.mean():.3f}, at least {WANTED} in {(trials >= WANTED).sum()} of {len(trials)} "
            f"trials; {count} corruptions: {', '.join(IMAGE_PAIR[one] for one in corruptions)}",
            flush=True,
        )
    of_pairs(measured, full)


def of_pairs(measured: Measured, full: np.ndarray) -> None:
    """Print how well random subsets of the pairs preserve the ranking under all conditions."""
    rng, pairs = np.random.default_rng(0), len(measured.errors)
    for share in (0.25, 0.5, 0.75, 0.9):
        count = max(1, round(share * pairs))
        drawn = (rng.choice(pairs, count, replace=False) for _ in range(DRAWS))
        means = [measured.means(SEVERITIES, each) for each in drawn]
        without = [
            (np.delete(each, lost, 1), np.delete(full, lost, 1)) for each in means for lost in range(full.shape[1])
        ]
        taus = [Population(*each).tau(range(len(IMAGE_PAIR))) for each in without]
        reached = 100 * np.mean(np.array(taus) >= WANTED)
        print(f"{count} of {pairs} pairs, all conditions: mean tau {np.mean(taus):.3f}, {reached:.0f} % of trials")


def methods() -> dict[str, Predict]:
    """Methods that run without a download: the shipped models, presets, and the same methods applied to filtered
    frames."""

    def named(name: str, **options: object) -> Predict:
        return load_model(name, **options).predict  # type: ignore[union-attr]

    def after(change: Callable[[Frame], Frame], predict: Predict) -> Predict:
        return lambda one, two: predict(change(one), change(two))

    def equalised(frame: Frame) -> Frame:
        return cv2.cvtColor(cv2.equalizeHist(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)), cv2.COLOR_GRAY2RGB)

    def halved(frame: Frame) -> Frame:
        return cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)

    def coarse(predict: Predict) -> Predict:
        def enlarged(one: Frame, two: Frame) -> Flow:
            return 2 * cv2.resize(predict(halved(one), halved(two)), (one.shape[1], one.shape[0]))

        return enlarged

    dis, farneback = named("dis"), named("farneback")
    return {
        "dis": dis,
        "dis fast": named("dis", preset="fast"),
        "dis ultrafast": named("dis", preset="ultrafast"),
        "dis_rgb": named("dis_rgb"),
        "dis, median 5": after(lambda frame: cv2.medianBlur(frame, 5), dis),
        "dis, equalised": after(equalised, dis),
        "dis, half size": coarse(dis),
        "farneback": farneback,
        "farneback, window 9": named("farneback", winsize=9),
        "farneback, window 25": named("farneback", winsize=25),
        "farneback, 5 levels": named("farneback", levels=5, poly_n=7, poly_sigma=1.5),
        "farneback, median 5": after(lambda frame: cv2.medianBlur(frame, 5), farneback),
        "tiny": named("tiny"),
        "tiny_all": named("tiny_all"),
    }


def reduced(sample: Sample, step: int) -> Sample:
    """A sample reduced by the factor `step`: frames are area-averaged, flow is taken from every `step`-th pixel."""
    assert sample.flow is not None
    assert sample.valid is not None
    height, width = (side // step for side in sample.shape)
    cut = [frame[: height * step, : width * step] for frame in sample.frames[:2]]
    frames = tuple(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in cut)
    middle = slice(step // 2, None, step)
    flow, valid = (part[middle, middle][:height, :width] for part in (sample.flow / step, sample.valid))
    return Sample(sample.key, frames, np.ascontiguousarray(flow), np.ascontiguousarray(valid))


def samples(data: Sequence[str]) -> Iterator[tuple[str, Sample]]:
    """The 80 pairs by name; real and generated pairs are interleaved."""
    real = [("motorcycle", load_dataset("motorcycle"), "motorcycle")]
    for given in data:
        name, _, root = given.partition("=")
        dataset = load_dataset(name, root)
        real += [(name, dataset, key) for key in dataset.keys()]  # noqa: SIM118
    shapes = load_dataset("shapes", pairs=PAIRS, size="80x112")
    made = [("shapes", shapes, key) for key in shapes.keys()[: PAIRS - len(real)]]
    every = sorted(enumerate([*real, *made]), key=lambda item: (item[0] * 0.618) % 1)
    for _, (name, dataset, key) in every:
        sample = dataset.load(key)
        yield f"{name} {key}", sample if name == "shapes" else reduced(sample, 4 if name == "middlebury" else 5)


def measure(output: Path, data: Sequence[str]) -> None:
    """Write EPE and RCRE of every method, pair, corruption and severity."""
    cv2.setNumThreads(1)
    predictors = methods()
    names, clean, errors = list[str](), [], []
    start = time.process_time()
    for name, sample in samples(data):
        flows = [predict(*sample.frames) for predict in predictors.values()]
        clean.append([float(epe_map(flow, sample.flow)[sample.valid].mean()) for flow in flows])
        cells = np.empty((len(flows), len(IMAGE_PAIR), len(SEVERITIES), 2))
        for place, corruption in enumerate(IMAGE_PAIR):
            for level, severity in enumerate(SEVERITIES):
                frames = corrupt(*sample.frames, corruption, severity)
                for one, predict in enumerate(predictors.values()):
                    flow = predict(*frames)
                    for column, other in enumerate((sample.flow, flows[one])):
                        cells[one, place, level, column] = epe_map(flow, other)[sample.valid].mean()
        names.append(name)
        errors.append(cells)
        np.savez(output, methods=list(predictors), pairs=names, clean=clean, errors=errors)
        print(f"{len(names)}/{PAIRS} {name}: {time.process_time() - start:.0f} s on one core", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    measuring = commands.add_parser("measure")
    measuring.add_argument("errors", type=Path)
    measuring.add_argument("--data", action="append", default=[], metavar="NAME=DIR")
    choosing = commands.add_parser("choose")
    choosing.add_argument("errors", type=Path)
    choosing.add_argument("--most", type=int, default=100, help="maximum number of conditions to try")
    options = parser.parse_args()
    if options.command == "measure":
        measure(options.errors, options.data)
    else:
        choose(options.errors, options.most)


if __name__ == "__main__":
    main()
