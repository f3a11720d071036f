"""The sections of `bench/gpu.py`. Each section reports rows; a failure within a section is also reported as a row."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # of tests.parity.weight_rule

PAPER = (
    "raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer", "flowformer_pp", "samflow_t", "samflow_b",
    "samflow_h", "flowdiffuser", "arflow", "upflow", "brightflow",
)  # fmt: skip
NEWEST = ("ptlflow:sea_raft_s", "ptlflow:dpflow", "ptlflow:rpknet", "ptlflow:neuflow2", "ptlflow:waft_twins_a2")
MEASURED = ("raft", "flowformer", "ptlflow:sea_raft_s")
TOLERANCES = {"fp32": 2e-3, "batched": 1e-3, "tf32": 0.01, "bf16": 0.03}
"""Tolerances relative to the flow's largest component (at least 1 px): for the maximum difference in fp32, and for the
mean difference in the other precisions.
"""
GOAL = 1.05
"""Maximum acceptable ratio of wall time to the model's own time, after the first row."""


@dataclass(frozen=True)
class Bench:
    """State shared by the sections.

    Attributes:
        device: name of the device: "cuda", "cpu", ...
        data: folder of KITTI 2015.
        quick: whether to use small frames and few repetitions.
        add: function that reports a row: a title, the results, and whether they are as expected (None without an
            expectation).
    """

    device: str
    data: Path
    quick: bool
    add: Callable[[str, dict[str, Any], bool | None], None]

    @contextmanager
    def row(self, what: str) -> Iterator[None]:
        """Report an exception within the block as a row."""
        try:
            yield
        except Exception as error:
            self.add(what, {"failed": f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"}, False)
            if self.device != "cpu":
                import torch

                torch.cuda.empty_cache()

    def frames(self, count: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
        from robustflow.data.datasets import load_dataset

        dataset = load_dataset("kitti2015", self.data)
        return [dataset.load(key).frames for key in dataset.keys()[:count]]


def networks(bench: Bench) -> None:
    """Compare every network on the device with the same network on the CPU: in fp32, in a batch, with TF32, in bf16."""
    first, second = bench.frames(2)
    height, width = (128, 160) if bench.quick else (256, 448)
    pairs = [tuple(np.ascontiguousarray(frame[:height, :width]) for frame in pair) for pair in (first, second)]
    for name in ("arflow", "raft") if bench.quick else (*PAPER, *NEWEST):
        with bench.row(name):
            bench.add(name, *_agreement(bench, name, pairs))


def _agreement(bench: Bench, name: str, pairs: list[Any]) -> tuple[dict[str, Any], bool]:
    import torch

    here, there = (_network(name, device) for device in ("cpu", bench.device))
    there.net.load_state_dict(here.net.state_dict())
    expected = here.run([pairs[0][0]], [pairs[0][1]])[0]
    scale = max(1.0, float(np.abs(expected).max()))
    alone = there.run([pairs[0][0]], [pairs[0][1]])[0]
    batched = there.run([pairs[0][0], pairs[1][0]], [pairs[0][1], pairs[1][1]])[0]
    found = {"fp32": np.abs(alone - expected).max(), "batched": np.abs(batched - alone).max()}
    torch.set_float32_matmul_precision("high")
    with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=True):
        found["tf32"] = np.abs(_by_hand(there, pairs[0], False) - expected).mean()
    torch.set_float32_matmul_precision("highest")
    found["bf16"] = np.abs(_by_hand(there, pairs[0], True) - expected).mean()
    figures = {key: float(f"{value / scale:.2g}") for key, value in found.items()}
    return {**figures, "largest flow": round(scale, 1)}, all(figures[key] <= TOLERANCES[key] for key in figures)


def _network(name: str, device: str, **options: Any) -> Any:
    """A network with the weights that the parity packs use; with PyTorch's random weights, most networks hardly react
    to the frames.
    """
    from robustflow import load_model
    from robustflow.core.plugins import parameters_of
    from robustflow.models.registered import MODELS
    from tests.parity.weight_rule import fill_by_rule

    known = parameters_of(MODELS.get(name)) if name in MODELS else ("iterations",)
    small = {"iterations": 2, "tile": "none", "size": "native"}
    options = {key: value for key, value in small.items() if key in known} | options
    try:
        model = load_model(name, checkpoint="random", device=device, **options)
    except Exception:
        options.pop("iterations", None)  # some ptlflow networks do not have this option
        model = load_model(name, checkpoint="random", device=device, **options)
    if device == "cpu":
        fill_by_rule(model.net, 2**0.5 if name in ("arflow", "upflow") else 0.8)
    return model


def _by_hand(model: Any, pair: Any, bf16: bool) -> np.ndarray:
    """The model's flow for a pair, without its own safeguards against TF32."""
    import torch

    from robustflow.models.torch.network_model import fitted_images, unfitted_flow

    height, width = pair[0].shape[:2]
    with torch.inference_mode():
        images = [fitted_images([frame], model.convention, model.device) for frame in pair]
        with torch.autocast(model.device.type, torch.bfloat16, enabled=bf16):
            flow = model.net(*images)
        flow = unfitted_flow(flow.float(), model.convention, height, width)
        return flow[0].permute(1, 2, 0).cpu().numpy()


class _Clock:
    """Records when each unit was written to disk, and how many seconds the model spent on it."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.predicting: list[float] = []

    def start(self, folder: Path, total: int, found: int) -> None:
        self.times = [time.perf_counter()]

    def advance(self, done: Any) -> None:
        self.times.append(time.perf_counter())
        self.predicting.append(done.seconds["predict"])


def _run(bench: Bench, name: str, what: str, **changes: Any) -> None:
    import robustflow as rf
    from robustflow.models import ModelRef

    options = {"checkpoint": "random", "device": bench.device, **changes.pop("options", {})}
    limits: dict[str, Any] = {"limit": 3}
    if bench.quick:
        limits = {"limit": 1, "corruptions": ["fog"], "severities": [3]}
    clock = _Clock()
    with tempfile.TemporaryDirectory() as scratch:
        result = rf.evaluate(
            ModelRef.parse(name, tuple(options.items())), "kitti-fc", bench.data, Path(scratch) / "run", progress=clock,
            **limits, **changes,
        )  # fmt: skip
        rows = len(result.rows)
    start, first, last = clock.times[0], clock.times[1], clock.times[-1]
    ratio = (last - first) / sum(clock.predicting[1:])
    figures = {"rows": rows, "wall s": last - start, "first row s": first - start, "model s": sum(clock.predicting)}
    figures = {key: round(value, 2) for key, value in figures.items()}
    bench.add(what, {**figures, "wall/model": round(ratio, 3)}, None if bench.quick else ratio <= GOAL)


def runs(bench: Bench) -> None:
    """Run three pairs under every image-pair corruption: staged, serial and compiled; report the wall time relative to
    the model's own time.
    """
    for name in MEASURED[:1] if bench.quick else MEASURED:
        staged: dict[str, Any] = {"workers": 2} if bench.device == "cpu" else {}
        for how, changes in (
            ("staged", staged),
            ("serial", {"engine": "serial"}),
            ("staged, compiled", {**staged, "options": {"compile": True}}),
        ):
            if bench.quick and how == "staged, compiled":
                continue  # compiling alone takes minutes
            with bench.row(f"{name}, {how}"):
                _run(bench, name, f"{name}, {how}", **changes)


def feeders(bench: Bench) -> None:
    """Run RAFT with two and with eight feeders."""
    for count in (2,) if bench.quick else (2, 8):
        with bench.row(f"raft, {count} feeders"):
            _run(bench, "raft", f"raft, {count} feeders", workers=count)


def memory(bench: Bench) -> None:
    """Measure peak memory and seconds per pair by batch size."""
    ((first, second),) = bench.frames()
    for name in ("raft_small",) if bench.quick else ("raft", "flowformer_pp", "samflow_b"):
        with bench.row(name):
            model = _network(name, bench.device, **({} if bench.quick else {"iterations": 12}))
            for size in (1, 2) if bench.quick else (1, 2, 4, 8):
                with bench.row(f"{name}, batch of {size}"), _watched(bench.device) as figures:
                    model.run([first] * size, [second] * size)
                bench.add(f"{name}, batch of {size}", {**figures, "s a pair": round(figures["s"] / size, 4)}, None)


@contextmanager
def _watched(device: str) -> Iterator[dict[str, Any]]:
    """The duration of a block in seconds and, on a GPU, the peak memory of its tensors in GiB."""
    figures: dict[str, Any] = {"s": float("nan")}
    gpu = device != "cpu"
    if gpu:
        import torch

        torch.cuda.synchronize()
        torch.cuda.reset_peak_memory_stats()
    start = time.perf_counter()
    yield figures
    if gpu:
        torch.cuda.synchronize()
        figures["GiB"] = round(torch.cuda.max_memory_allocated() / 2**30, 2)
    figures["s"] = round(time.perf_counter() - start, 4)


def training(bench: Bench) -> None:
    """Run three training steps of every method, in fp32 and in bf16."""
    from robustflow.training.recipe import trained_methods

    for method in ("raft_small", "arflow") if bench.quick else trained_methods():
        for precision in ("fp32", "bf16"):
            with bench.row(f"{method}, {precision}"):
                bench.add(f"{method}, {precision}", *_steps(bench, method, precision))


def _steps(bench: Bench, method: str, precision: str) -> tuple[dict[str, Any], bool]:
    import torch

    from robustflow.training.data.loader import Batch, WholeFrames
    from robustflow.training.network_with_loss import NetworkWithLoss
    from robustflow.training.optimization import build_optimizer
    from robustflow.training.recipe import load_recipe, recipes_of
    from robustflow.training.trained_network import load_network
    from robustflow.training.unsupervised.methods import TrainingStep

    crop, batch = ((128, 192), 2) if bench.quick else ((320, 448), 2)
    recipe = load_recipe(method, list(recipes_of(method))[-1])
    recipe = recipe.changed(crop=crop, batch=batch, precision=precision, devices=1)
    _, network = load_network(recipe, "random", bench.device)
    network.train()
    called, optimizer = NetworkWithLoss(network, recipe), build_optimizer(network, recipe)
    device = torch.device(bench.device)
    images = torch.rand(2, batch, 3, *crop, device=device) * 255
    flow = torch.zeros(batch, 2, *crop, device=device)
    noise = torch.randn(batch, 2, crop[0] // 8, crop[1] // 8, device=device)
    corners, sizes = torch.zeros(batch, 2), torch.tensor([[crop[1], crop[0]]] * batch, dtype=torch.float32)
    whole = WholeFrames(images[0], images[1], corners.to(device), sizes.to(device))
    given = Batch(
        images[0], images[1], flow, flow[:, 0] + 1, ("random",) * batch, time=500, noise=noise,
        whole=whole, plain=whole, changed=(images[0], images[1]),
    )  # fmt: skip
    losses, seconds = [], []
    figures: dict[str, Any] = {}
    for step in range(3):
        with _watched(bench.device) as watched:
            optimizer.zero_grad()
            loss, _ = called(given, TrainingStep(0, step, tuple(range(batch)), 0.5))
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        seconds.append(watched.pop("s"))
        figures = watched
    figures = {"s a step": seconds[-1], "first step s": seconds[0], "loss": round(losses[-1], 4), **figures}
    return figures, bool(np.isfinite(losses).all())


def resume(bench: Bench) -> None:
    """Start a run on the device and continue it on the CPU, and vice versa; different devices must be rejected."""
    import robustflow as rf
    from robustflow.models import ModelRef

    for began, continued in ((bench.device, "cpu"), ("cpu", bench.device)):
        what = f"raft_small started on {began}, continued on {continued}"
        with bench.row(what), tempfile.TemporaryDirectory() as scratch:
            for device, severities in ((began, [1]), (continued, [1, 2])):
                options = (("checkpoint", "random"), ("device", device), ("iterations", 2))
                try:
                    result = rf.evaluate(
                        ModelRef.parse("raft_small", options), "kitti-fc", bench.data, Path(scratch) / "run", limit=1,
                        corruptions=["fog"], severities=severities, engine="serial", progress=False,
                    )  # fmt: skip
                # devices are part of a run's identity, and the error message mentions them
                except rf.RobustFlowError as error:
                    bench.add(what, {"refused": str(error)[:300]}, began != continued)
                    break
            else:
                bench.add(what, {"rows": len(result.rows)}, began == continued and len(result.rows) == 3)


def loader(bench: Bench) -> None:
    """Measure whether a DataLoader whose workers corrupt samples keeps up with RAFT's training step."""
    import torch
    from torch.utils.data import DataLoader

    pairs, size = (16, (128, 192)) if bench.quick else (256, (320, 448))
    ((first, second),) = bench.frames()
    crops = [np.ascontiguousarray(frame[: size[0], : size[1]]) for frame in (first, second)]
    with bench.row("raft, fp32"):
        figures, _ = _steps(bench, "raft_small" if bench.quick else "raft", "fp32")
        needed = 2 / figures["s a step"]
        for workers in (1,) if bench.quick else (2, 4, 8):
            what = f"{workers} workers"
            with bench.row(what):
                loading = DataLoader(_Corrupted(crops, pairs), batch_size=2, num_workers=workers)
                start = time.perf_counter()
                for batch in loading:
                    torch.as_tensor(batch).to(bench.device)
                rate = pairs / (time.perf_counter() - start)
                figures = {"pairs/s": round(rate, 1), "pairs/s of the training step": round(needed, 1)}
                bench.add(what, figures, None if bench.quick else rate >= needed)


class _Corrupted:
    """A single pair that is corrupted differently every time."""

    def __init__(self, pair: list[np.ndarray], count: int) -> None:
        from robustflow.corruptions.transform import CorruptionTransform

        self._pair, self._count = pair, count
        self._transform = CorruptionTransform(probability=1.0, seed=0)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, number: int) -> np.ndarray:
        return np.stack(self._transform(self._pair, key=str(number)))


def attacks(bench: Bench) -> None:
    """Run PGD and PCFA on RAFT at KITTI's frame size, and PGD on a batch; report times and the number of flows."""
    import robustflow as rf
    from robustflow.attacks import load_attack
    from robustflow.attacks.api import attack_pairs
    from robustflow.attacks.problem import Pair

    ((first, second),) = bench.frames()
    small = {"pgd": {"steps": 2}, "pcfa": {"steps": 1}} if bench.quick else {"pgd": {}, "pcfa": {}}
    for name, options in small.items():
        with bench.row(name):
            model = _network("raft_small" if bench.quick else "raft", bench.device)
            with _watched(bench.device) as figures:
                attacked = rf.attack(first, second, model, name, severity=3, **options)
            figures["flows"] = attacked.evaluations
            figures["ms a flow"] = round(1e3 * figures["s"] / attacked.evaluations, 1)
            bench.add(name, figures, None)
    with bench.row("pgd in a batch"):
        model, attack = (
            _network("raft_small" if bench.quick else "raft", bench.device),
            load_attack("pgd", **small["pgd"]),
        )
        clean = model.predict(first, second)
        pairs = [(Pair((first, second), attack.budget(3), key=str(number), severity=3), clean) for number in range(4)]
        with _watched(bench.device) as figures:
            attacked = attack_pairs(attack, model, pairs)
        figures["flows"] = sum(one.evaluations for one in attacked)
        figures["ms a flow"] = round(1e3 * figures["s"] / figures["flows"], 1)
        bench.add("pgd in a batch of 4", figures, None)


SECTIONS: dict[str, tuple[Callable[[Bench], None], int]] = {
    "networks": (networks, 110),
    "runs": (runs, 170),
    "feeders": (feeders, 45),
    "memory": (memory, 35),
    "training": (training, 80),
    "resume": (resume, 20),
    "loader": (loader, 25),
    "attacks": (attacks, 45),
}
"""Function and time budget in seconds of each section, by name; 530 s in total."""
