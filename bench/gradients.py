"""Compare the whole gradient of networks with the gradient as they are written, and attacks that follow each.

    python bench/gradients.py networks [NAME ...] [--side 128] [--seconds 300]
    python bench/gradients.py attacks NAME --data ~/kitti2015 [--checkpoint FILE] [--pairs 5]

`networks` builds networks with random weights (by default all that can be built and attacked here), each in a process
with a time limit, and prints the cosine of both gradients, the ratio of their norms, and what finite differences say of
the whole one. `attacks` prints the mean error of a trained network on crops of 64x96 pixels with ground truth under
linf 4, PCFA under its own bound; a pair takes a minute with GMFlow on one core.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import argparse
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.evaluation import Evaluation, evaluate
from robustflow.attacks.gradient import check_gradient
from robustflow.attacks.problem import Pair
from robustflow.core.errors import RobustFlowError
from robustflow.core.types import Sample
from robustflow.models.protocols import Differentiable, FlowModel
from robustflow.testing import TexturePairs

OWN = ("arflow", "upflow", "brightflow", "flowdiffuser")
ATTACKS = ("pgd:starts=1", "apgd:starts=1:steps=20", "pcfa:steps=2")


def compared(model: Any, pair: Pair) -> tuple[float, float, str]:
    """Return the cosine of the whole gradient and the one as written, the ratio of their norms, and the verdict."""
    problem = load_attack("pgd").problem(model, pair, model.predict(*pair.frames))
    check_gradient(problem, pair.stream("gradient"))
    images = problem.ball.random(pair.stream("gradient"))
    both = []
    for whole in (True, False):
        found = evaluate(Evaluation(model, pair.key, images=images, loss=problem.loss, whole=whole)).gradient
        assert found is not None
        both.append(found.astype(np.float64))
    norms = [float(np.linalg.norm(one)) for one in both]
    cosine = float((both[0] * both[1]).sum()) / (norms[0] * norms[1]) if all(norms) else float("nan")
    return cosine, norms[0] / norms[1] if norms[1] else float("inf"), str(problem.verdict)


def crops(folder: Path, pairs: int, height: int = 64, width: int = 96) -> Iterator[Sample]:
    """Yield crops that have ground truth at half of their pixels, spread over the dataset."""
    dataset, rng = rf.load_dataset("kitti2015", folder), np.random.default_rng(0)
    keys, made = dataset.keys(), 0
    while made < pairs:
        sample = dataset.load(keys[made % len(keys)])
        top, left = (
            int(rng.integers(0, most - side)) for most, side in zip(sample.shape, (height, width), strict=True)
        )
        where = np.s_[top : top + height, left : left + width]
        assert sample.flow is not None
        assert sample.valid is not None
        if sample.valid[where].mean() > 0.5:
            made += 1
            first, second = (np.ascontiguousarray(frame[where]) for frame in sample.frames[:2])
            yield Sample(str(made), (first, second), sample.flow[where].copy(), sample.valid[where].copy())


def networks(names: list[str], side: int, seconds: int) -> None:
    if not names:
        import ptlflow

        prefixed = {"raft_small": "ptlflow:raft_small"}  # the name alone is that of torchvision
        names = [*OWN, *(prefixed.get(name, name) for name in sorted(ptlflow.get_model_names()))]
    sample = TexturePairs(1, (side, side)).load("0")
    pair = Pair((sample.frames[0], sample.frames[1]), 4.0, sample.flow, sample.valid, "0")
    for name in names:
        process = get_context("fork").Process(target=network, args=(name, pair))
        process.start()
        process.join(seconds)
        if process.is_alive():
            process.kill()
            print(f"| {name} | more than {seconds} s |", flush=True)


def network(name: str, pair: Pair) -> None:
    options = {} if name == "tiny" else {"checkpoint": "random"}
    try:
        model = rf.load_model(name, device="cpu", **options)
        if not isinstance(model, Differentiable) or not isinstance(model, FlowModel):
            print(f"| {name} | not attacked |", flush=True)
            return
        cosine, ratio, verdict = compared(model, pair)
        print(f"| {name} | {cosine:.2f} | {ratio:.2f} | {verdict} |", flush=True)
    except RobustFlowError as error:
        print(f"| {name} | {error} |", flush=True)


def attacks(name: str, folder: Path, checkpoint: str | None, pairs: int) -> None:
    model = rf.load_model(name, device="cpu", **({"checkpoint": checkpoint} if checkpoint else {}))
    errors: dict[str, list[float]] = {"clean": []}
    for sample in crops(folder, pairs):
        for attack in ATTACKS:
            for gradient in ("whole", "as-written"):
                budget = {"severity": 2} if attack == "pcfa" else {"budget": 4}
                options = {**budget, "flow": sample.flow, "valid": sample.valid, "key": sample.key}
                done = rf.attack(*sample.frames[:2], model, f"{attack}:gradient={gradient}", **options)
                errors.setdefault(f"{attack} {gradient}", []).append(done.loss)
        distance = np.linalg.norm(model.predict(*sample.frames[:2]) - sample.flow, axis=-1)
        errors["clean"].append(float(distance[sample.valid].mean()))
        print(sample.key, {key: round(values[-1], 2) for key, values in errors.items()}, flush=True)
    for key, values in errors.items():
        print(f"{name} {key}: {np.mean(values):.2f} px over {len(values)} pairs")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("networks", "attacks"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--checkpoint")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--seconds", type=int, default=300)
    given = parser.parse_args()
    if given.what == "networks":
        networks(given.names, given.side, given.seconds)
    else:
        attacks(given.names[0], given.data, given.checkpoint, given.pairs)


if __name__ == "__main__":
    main()
