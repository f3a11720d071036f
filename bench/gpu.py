"""Run all GPU checks with a single command, which takes at most nine minutes and needs no network:

    python bench/gpu.py [--device cuda] [--data FOLDER_OF_KITTI_2015] [--output gpu-results] [--quick] [SECTION ...]

Beforehand, on a machine with a network, `python bench/gpu.py --prepare FOLDER` saves the wheels for the GPU machine and
three pairs of 375x1242 pixels (flying shapes, in KITTI's layout). The networks' random weights are generated from
seeds, so that no weights have to be copied.

Each section runs in a separate process with a time budget in seconds. A failure is reported as a row with its message,
and earlier rows are kept; `results.json` and `results.md` in the output folder are written after every section.
`--quick` runs the same checks on small frames with few repetitions, to test the script on a CPU.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from gpu_sections import ROOT, SECTIONS, Bench


def in_child(name: str, options: argparse.Namespace, rows: Path) -> None:
    """Run one section, and write each of its rows as soon as it is available."""
    with rows.open("a") as file:

        def add(what: str, figures: dict[str, Any], good: bool | None) -> None:
            file.write(json.dumps({"section": name, "what": what, "figures": figures, "as expected": good}) + "\n")
            file.flush()

        SECTIONS[name][0](Bench(options.device, options.data, options.quick, add))


def supervised(name: str, options: argparse.Namespace, scratch: Path) -> list[dict[str, Any]]:
    """The rows of one section, computed in a separate process within the section's time budget."""
    rows = scratch / f"{name}.jsonl"
    command = [sys.executable, __file__, "--section", str(rows), "--device", options.device]
    command += ["--data", str(options.data), *(["--quick"] if options.quick else []), name]
    budget = options.budget or SECTIONS[name][1]
    start = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=budget)
        last = next((line for line in reversed(done.stderr.splitlines()) if line.strip()), "")
        ended = f"the process exited with {done.returncode}: {last[:300]}" if done.returncode else ""
    except subprocess.TimeoutExpired:
        ended = f"stopped after its time budget of {budget} s; its earlier results are above"
    found = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
    seconds = {"s": round(time.perf_counter() - start, 1), **({"failed": ended} if ended else {})}
    return [*found, {"section": name, "what": "the whole section", "figures": seconds, "as expected": not ended}]


def markdown(about: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Format the results as one table."""
    words = {True: "yes", False: "**no**", None: ""}
    lines = [", ".join(f"{key} {value}" for key, value in about.items()), ""]
    lines += ["| section | what | results | as expected |", "|---|---|---|---|"]
    for row in rows:
        figures = ", ".join(f"{key} {value}" for key, value in row["figures"].items()).replace("|", "/")
        lines.append(f"| {row['section']} | {row['what']} | {figures} | {words[row['as expected']]} |")
    return "\n".join(lines) + "\n"


def machine(device: str) -> dict[str, Any]:
    """Versions and settings that affect the results."""
    import torch

    import robustflow

    gpu = torch.cuda.get_device_name() if device.startswith("cuda") and torch.cuda.is_available() else "none"
    return {
        "robustflow": robustflow.__version__,
        "torch": torch.__version__,
        "device": device,
        "GPU": gpu,
        "CUDA": torch.version.cuda or "none",
        "processors": len(__import__("os").sched_getaffinity(0)),
        "python": platform.python_version(),
    }


def make_pairs(folder: Path, size: tuple[int, int]) -> None:
    """Write three pairs of flying shapes in KITTI's layout."""
    from robustflow.data.datasets import load_dataset
    from robustflow.media.flow import write_flow
    from robustflow.media.images import write_image

    dataset = load_dataset("shapes", pairs=3, size=f"{size[0]}x{size[1]}")
    for kind in ("image_2", "flow_occ", "flow_noc"):
        (folder / "training" / kind).mkdir(parents=True, exist_ok=True)
    for number, key in enumerate(dataset.keys()):
        sample = dataset.load(key)
        for which, frame in zip((10, 11), sample.frames, strict=True):
            write_image(folder / "training" / "image_2" / f"{number:06d}_{which}.png", frame)
        for kind, valid in (("flow_occ", sample.valid), ("flow_noc", sample.valid & ~sample.occluded)):
            write_flow(folder / "training" / kind / f"{number:06d}_10.png", sample.flow, valid)


def prepare(folder: Path) -> None:
    """Write the pairs and the wheels of all packages except PyTorch, which is already installed on a machine
    with a GPU.
    """
    make_pairs(folder / "kitti", (375, 1242))
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--dest", str(folder / "wheels")]
    command += ["--constraint", str(ROOT / "constraints.txt"), f"{ROOT}[ptlflow]"]
    subprocess.run(command, check=True)
    print(
        f"copy {folder} and this checkout to the GPU machine, and run there: "
        "pip install --no-index --find-links wheels 'robustflow[ptlflow]'"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", choices=[[], *SECTIONS], help="by default all")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--data", type=Path, help="folder of KITTI 2015, or the folder kitti/ created by --prepare")
    parser.add_argument("--output", type=Path, default=Path("gpu-results"))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--budget", type=int, help="time budget of every section in seconds, instead of its default")
    parser.add_argument("--prepare", type=Path, metavar="FOLDER")
    parser.add_argument("--section", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.prepare:
        prepare(options.prepare)
        return 0
    if options.section:
        in_child(options.sections[0], options, options.section)
        return 0
    options.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        if options.data is None:
            options.data = Path(scratch) / "kitti"
            make_pairs(options.data, (128, 224) if options.quick else (375, 1242))
        about, rows = machine(options.device), []
        for name in options.sections or SECTIONS:
            rows += supervised(name, options, Path(scratch))
            (options.output / "results.json").write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")
            (options.output / "results.md").write_text(markdown(about, rows))
            print(f"{name}: {rows[-1]['figures']}", flush=True)
    return int(any(row["as expected"] is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
