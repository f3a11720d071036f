"""Kill a run with each engine, and a training, twice (SIGKILL), continue them, and compare their files with those of an
undisturbed one: rows and summary, or checkpoint and log. Each kill waits for a random one of the missing rows or
updates, but for none of the last tenth. Print a line per kill, with the processes that outlive it by 10 s, and then a
line per engine, with the folders that are left in the folder for temporary files.

    python bench/kills.py [serial processes device ray training] --kills 20
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import polars as pl

import robustflow as rf

RUN = ["run", "-m", "kills:Slow", "-b", "folder", "-c", "fog,contrast,gaussian_noise,jpeg_compression", "--no-examples"]
TRAIN = ["train", "tiny", "--recipe", "shapes", "--mix", "small_shapes", "--init", "random", "--save-every", "1"]
TRAIN += ["--steps", "20", "--batch-size", "1", "--crop", "64x64", "--seed", "3"]
WHAT = {
    "serial": [*RUN, "--engine", "serial"],
    "processes": [*RUN, "--engine", "processes", "--workers", "2"],
    "device": [*RUN, "--engine", "processes", "--workers", "2", "-O", "device=cuda:0"],
    "ray": [*RUN, "--engine", "ray", "--workers", "2"],
    "training": [*TRAIN, "--loaders", "2"],
}
STEPS = dict.fromkeys(WHAT, "rows") | {"training": "updates"}


class Slow:
    """DIS with a pause; it may claim to be on an accelerator."""

    def __init__(self, device: str = "cpu") -> None:
        self.device, self._model = device, rf.load_model("dis")

    def predict(self, frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
        time.sleep(0.05)
        return self._model.predict(frame1, frame2)


def start(what: str, whole: Path, output: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "robustflow", *WHAT[what], "--output", str(output)]
    if what != "training":
        command += ["--data", str(whole / "frames")]
    elif (output / "last.pth").exists():
        command.append("--resume")
    else:
        (output / "metrics.jsonl").unlink(missing_ok=True)
    own = {"PYTHONPATH": str(Path(__file__).parent), "TMPDIR": str(whole / "t")}
    with open(whole / "errors", "wb") as errors:
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, env={**os.environ, **own})


def progress(output: Path) -> int:
    """Return the number of rows of a run, or of updates of a training."""
    with suppress(OSError, pl.exceptions.PolarsError):  # shards are packed meanwhile
        if shards := list(output.glob("rows/*.parquet")):
            return (
                pl.scan_parquet(shards)
                .select(pl.struct("sample", "corruption", "severity").n_unique())
                .collect()
                .item()
            )
        return len((output / "metrics.jsonl").read_text().splitlines())
    return 0


def reached(process: subprocess.Popen[bytes], output: Path, wanted: int) -> bool:
    """Wait until a run has a number of rows, or a training of updates; return False if it ended before that."""
    while progress(output) < wanted:
        if process.poll() is not None:
            return False
        time.sleep(0.01)
    return True


def outcome(output: Path) -> tuple[object, bytes]:
    """Return the rows and the summary of a run, or the log and the checkpoint of a training."""
    if (output / "last.pth").exists():
        lines = (output / "metrics.jsonl").read_text().splitlines()
        return [json.loads(line) | {"seconds": 0} for line in lines], (output / "last.pth").read_bytes()
    rows = rf.load_run(output).rows.sort("sample", "corruption", "severity").rows()
    return rows, (output / "summary.json").read_bytes()


def left_over(mark: str) -> list[str]:
    """Return the processes that have a folder in their environment or command or among their open files after at most
    10 s."""
    deadline = time.monotonic() + 10
    while True:
        left = [process.name for process in Path("/proc").glob("[0-9]*") if _has(process, mark)]
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.2)


def _has(process: Path, mark: str) -> bool:
    for name in ("environ", "cmdline"):
        with suppress(OSError):
            if mark.encode() in (process / name).read_bytes():
                return True
    with suppress(OSError):
        return any(mark in os.readlink(file) for file in (process / "fd").iterdir())
    return False


def finished(process: subprocess.Popen[bytes], whole: Path) -> None:
    if process.wait() != 0:
        raise SystemExit(f"exit code {process.returncode}:\n{(whole / 'errors').read_text()}")


def kill(what: str, wanted: int, whole: Path) -> None:
    (whole / "t").mkdir()
    (whole / "frames").mkdir()
    texture = np.kron(np.random.default_rng(0).integers(0, 256, (20, 24, 3), np.uint8), np.ones((4, 4, 1), np.uint8))
    for number in range(6):
        cv2.imwrite(str(whole / f"frames/{number}.png"), texture[:64, 2 * number : 2 * number + 80])
    process = start(what, whole, whole / "undisturbed")
    reached(process, whole / "undisturbed", 1)
    first = time.monotonic()
    finished(process, whole)
    total, moments, undisturbed = progress(whole / "undisturbed"), random.Random(1), outcome(whole / "undisturbed")
    step, latest = (time.monotonic() - first) / total, total * 9 // 10
    print(f"{what}: undisturbed, {total} {STEPS[what]}", flush=True)
    kills = between = ends = first_differ = second_differ = processes = 0
    while kills < wanted:
        output, kept = whole / str(ends), 0
        for _ in range(2):
            if kept >= latest:
                break
            process = start(what, whole, output)
            if not reached(process, output, moments.randint(kept + 1, latest)):
                break
            time.sleep(moments.uniform(0, step))
            process.kill()
            if process.wait() == 0:
                break
            kills, kept, left = kills + 1, progress(output), left_over(str(whole))
            between += 0 < kept < total
            processes += len(left)
            print(f"{what}: kill {kills}, kept {kept} of {total} {STEPS[what]}, processes left {left}", flush=True)
        finished(start(what, whole, output), whole)
        logs, files = (a != b for a, b in zip(outcome(output), undisturbed, strict=True))
        ends, first_differ, second_differ = ends + 1, first_differ + logs, second_differ + files
        print(f"{what}: end {ends}, differs {logs}, {files}", flush=True)
    folders = sorted(path.name.split("-")[0] for path in (whole / "t").iterdir())
    names = ("logs", "checkpoints") if what == "training" else ("rows", "summaries")
    print(
        f"{what}: {kills} kills, {between} of them between the first and the last of the {STEPS[what]}, {ends} ends, "
        f"{first_differ} {names[0]} and {second_differ} {names[1]} differ, "
        f"{processes} processes and {len(folders)} folders left ({', '.join(sorted(set(folders)))})",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=list(WHAT), help=f"some of {', '.join(WHAT)}")
    parser.add_argument("--kills", type=int, default=20)
    options = parser.parse_args()
    for what in options.what:
        with tempfile.TemporaryDirectory() as whole:
            kill(what, options.kills, Path(whole))


if __name__ == "__main__":
    main()
