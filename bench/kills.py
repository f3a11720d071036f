"""Kill a run with each engine, and a training, at random moments (SIGKILL), continue them, and compare rows and weights
with those of an undisturbed one; report the processes that outlive a kill by 10 s.

    python bench/kills.py [serial processes ray training] --kills 20
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RUN = ["run", "tiny", "-c", "fog,contrast,gaussian_noise,jpeg_compression", "--no-examples"]
TRAIN = ["train", "tiny", "--recipe", "shapes", "--mix", "small_shapes", "--init", "random", "--save-every", "1"]
TRAIN += ["--steps", "60", "--batch-size", "1", "--crop", "64x64", "--seed", "3"]
WHAT = {
    "serial": [*RUN, "--engine", "serial"],
    "processes": [*RUN, "--engine", "processes", "--workers", "2"],
    "ray": [*RUN, "--engine", "ray", "--workers", "2"],
    "training": [*TRAIN, "--loaders", "2"],
}


def start(what: str, folder: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "robustflow", *WHAT[what], "--output", str(folder)]
    if (folder / "last.pth").exists():
        command.append("--resume")
    elif what == "training":
        for left in folder.glob("metrics.jsonl"):
            left.unlink()
    environment = {**os.environ, "BENCH_KILLS": str(folder)}
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)


def outcome(what: str, folder: Path) -> object:
    """Return the rows of a run, or the weights and the log of a training."""
    if what != "training":
        import robustflow as rf

        return rf.load_run(folder).rows.sort("sample", "corruption", "severity").rows()
    import torch

    weights = torch.load(folder / "last.pth", weights_only=True)["model"]
    log = [json.loads(line) | {"seconds": 0} for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return {name: value.tolist() for name, value in weights.items()}, log


def left_over(folder: Path) -> int:
    """Return the number of processes with the mark of this script in their environment after at most 10 s."""
    mark, deadline = f"BENCH_KILLS={folder}".encode(), time.monotonic() + 10
    while True:
        count = 0
        for path in Path("/proc").glob("[0-9]*/environ"):
            try:
                count += mark in path.read_bytes()
            except OSError:
                continue
        if not count or time.monotonic() > deadline:
            return count
        time.sleep(0.2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=list(WHAT), help=f"some of {', '.join(WHAT)}")
    parser.add_argument("--kills", type=int, default=20)
    options = parser.parse_args()
    for what in options.what:
        with tempfile.TemporaryDirectory() as folder:
            began = time.monotonic()
            assert start(what, Path(folder, "whole")).wait() == 0
            length, moments = time.monotonic() - began, random.Random(1)
            whole, kills, ends, differing, left = outcome(what, Path(folder, "whole")), 0, 0, 0, 0
            place = Path(folder, "0")
            while kills < options.kills:
                process = start(what, place)
                try:
                    process.wait(moments.uniform(0.3, 0.9) * length)
                except subprocess.TimeoutExpired:
                    process.send_signal(signal.SIGKILL)
                    process.wait()
                    kills += 1
                    left += left_over(place)
                    continue
                ends += 1
                differing += process.returncode != 0 or outcome(what, place) != whole
                place = Path(folder, str(ends))
            process = start(what, place)
            differing += process.wait() != 0 or outcome(what, place) != whole
            print(f"{what}: {kills} kills, {ends + 1} ends, {differing} differ, {left} processes left", flush=True)


if __name__ == "__main__":
    main()
