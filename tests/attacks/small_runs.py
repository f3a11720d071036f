"""Runs on two small pairs under attacks and corruptions, and a model without gradients."""

import numpy as np
import polars as pl

import robustflow as rf
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelRef
from robustflow.run.run import Run
from robustflow.stats.frame import results_frame
from robustflow.stats.lines import Numbers, lines_of
from robustflow.testing import TexturePairs

TINY = ModelRef.parse("tiny", (("device", "cpu"),))
DATA = TexturePairs(2, (40, 48))


def still(frame1, frame2):
    """Predict a flow that depends on both frames, without a gradient."""
    return (frame1.astype(np.float32) - frame2)[..., :2] / 20


def pairs(count: int = 2) -> Benchmark:
    return Benchmark("drawn", DATA, DATA.keys()[:count], ("contrast", "high_light"), (1, 3))


def run(folder, model=TINY, *, attacks=("fgsm", "pgd"), severities=(1, 3), count=2, **options):
    options = {"examples": False, "progress": False, "engine": "serial", **options}
    return rf.evaluate(model, pairs(count), output=folder, attacks=attacks, severities=severities, **options)


def every(result) -> pl.DataFrame:
    return pl.concat([result.rows, result.attack_rows]).unique().sort("sample", "corruption", "severity")


def numbers_of(attacked: Run) -> Numbers:
    """Return the line of a run in the results frame."""
    (numbers,) = lines_of(results_frame([attacked], ["means", "attacks"])).values()
    return numbers
