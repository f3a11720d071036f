"""Measure how long it takes to write the pages after a run, to write them for many models or runs, and to load them in
a browser.

    python bench/site.py [--models 100] [--loads 5]
    python bench/site.py --runs 200 [--pairs 20]

Writing is measured in CPU seconds, so that other load on the machine has little influence. Loading times are from the
browser's `performance.timing`: until the page's script has finished, and until the page is loaded, each the minimum
over several visits. With `--runs`, the given number of run folders is created first; `robustflow leaderboard` then
writes their page in a separate process, whose CPU and wall-clock seconds and peak memory are printed.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import polars as pl
from synthetic_runs import synthetic_runs

from robustflow.api import evaluate
from robustflow.report.site import render_site, run_content, whole_content
from robustflow.stats.published.tables import published_frame

_TIMING = """() => {
    const { navigationStart, domContentLoadedEventEnd, loadEventEnd } = performance.timing;
    return [domContentLoadedEventEnd - navigationStart, loadEventEnd - navigationStart];
}"""
_QUIET = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-sync"]


def many_models(count: int) -> pl.DataFrame:
    """Results of `count` models: copies of a published model, each slightly worse than the previous one and with a
    different name."""
    raft = published_frame().filter(benchmark="kitti-fc", setting="ID", model="RAFT")
    models = []
    for index in range(count):
        texts = {"model": f"Model {index:03d}", "setting": ("OOD", "ID", "own")[index % 3], "sample_set": "file"}
        changed = {name: pl.lit(text) for name, text in texts.items()}
        models.append(raft.with_columns(value=pl.col("value") * (1 + 0.01 * index), **changed))
    return pl.concat(models)


def seconds(make: Callable[[], str]) -> tuple[str, float]:
    """The result of a function, and the CPU seconds of its second call (the first call imports modules)."""
    make()
    start = time.process_time()
    return make(), time.process_time() - start


def load_times(path: Path, loads: int) -> tuple[float, float] | None:
    """Minimum time in milliseconds until the script has run and until the page is loaded; None without a browser."""
    chromium = shutil.which("chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    if chromium is None:
        return None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=_QUIET)
        times = []
        for _ in range(loads):
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(path.as_uri(), wait_until="load")
            page.wait_for_timeout(100)
            times.append(page.evaluate(_TIMING))
            page.close()
        browser.close()
    return min(first for first, _ in times), min(last for _, last in times)


def leaderboard_of(count: int, pairs: int, loads: int, folder: Path) -> None:
    """Print the cost of a leaderboard of `count` run folders with `pairs` pairs each."""
    paths = synthetic_runs(folder / "runs", count, pairs)
    output = folder / "site"
    command = [
        sys.executable,
        "-c",
        "from robustflow.cli.main import main; main()",
        "leaderboard",
        *map(str, paths),
        "-o",
        str(output),
    ]
    for state in ("first call, without caches", "second call, with caches"):
        before, start = os.times(), time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        wall, after = time.perf_counter() - start, os.times()
        user = after.children_user - before.children_user
        system = after.children_system - before.children_system
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024  # maximum over all child processes so far
        print(
            f"{count} runs of {pairs} pairs, {state}: {wall:.1f} s, {user:.1f} user s, {system:.1f} system s, ", end=""
        )
        print(f"{peak:.0f} MB peak")
    page = output / "index.html"
    found = load_times(page, loads)
    print(f"page {page.stat().st_size / 1e6:.2f} MB; ", end="")
    print("no browser" if found is None else f"script {found[0]:.0f} ms, loaded {found[1]:.0f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=0)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--models", type=int, default=100)
    parser.add_argument("--loads", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if options.runs:
            leaderboard_of(options.runs, options.pairs, options.loads, folder)
            return
        run = evaluate("dis", "demo", output=folder / "run", examples=True)
        pages: dict[str, Callable[[], str]] = {
            "report.html of a run": lambda: render_site(run_content(run)),
            "published results": lambda: render_site(whole_content([])),
            f"with {options.models} more models": lambda: render_site(
                whole_content([], [("many.csv", many_models(options.models))])
            ),
        }
        print(f"{'page':30} {'MB':>6} {'write, CPU s':>13} {'script ms':>10} {'loaded ms':>10}")
        for name, make in pages.items():
            text, spent = seconds(make)
            path = folder / "page.html"
            path.write_text(text, encoding="utf-8")
            found = load_times(path, options.loads)
            shown = "no browser".rjust(21) if found is None else f"{found[0]:10.0f} {found[1]:10.0f}"
            print(f"{name:30} {path.stat().st_size / 1e6:6.2f} {spent:13.2f} {shown}")


if __name__ == "__main__":
    main()
