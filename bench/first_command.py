"""Measure where the README's first command, `robustflow run --model dis` on the embedded pair, spends its time.

    python bench/first_command.py [--model tiny] [--rounds 1] [--top 12] [--against ../other/src]

The script runs the command cold (without any compiled code or library cache) and warm (with the caches of the cold
run), in a temporary folder; the user's caches are neither read nor written. Every process of the command, including
workers, measures the CPU time that its main thread spends in each part, excluding nested parts: imports by package,
reading or compiling each Numba function, every corruption, the model, measuring, images, pages. The first column is the
total, followed by one column per process. The last number of a run's line is its CPU time as a multiple of the cost of
its rows: reading, corrupting, predicting and measuring, without loading or compiling code.

Wall-clock times are unreliable on a busy machine: compare CPU times. To compare two versions in alternating runs, use
`--against` with a folder that contains the other version of `robustflow`.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

PR_SET_CHILD_SUBREAPER = 36
REPORTS = "FIRST_COMMAND_REPORTS"
"""Environment variable that contains the folder for the processes' reports."""

PARTS: dict[str, dict[str, str]] = {
    "numba.core.dispatcher": {"Dispatcher.compile": "numba: compile {0.py_func.__module__}.{0.py_func.__qualname__}"},
    "numba.core.caching": {"FunctionCache.load_overload": "numba: read {0._py_func.__module__}.{0._py_func.__name__}"},
    "robustflow.run.setup": {"set_up": "set up", "open_benchmark": "set up"},
    "robustflow.run.plan": {"name_model": "model: load"},
    "robustflow.run.stages": {
        "FrameStage.load": "sample",
        "FrameStage._corrupted": "corruption: {2}",
        "slider_picture": "pictures: slider",
        "PredictStage.predict": "model: predict",
    },
    "robustflow.corruptions.optics.psf_field": {"shipped_field": "lens tables"},
    "robustflow.corruptions.optics.blur": {"_kernels": "lens tables"},
    "robustflow.run.worker": {"Computation.row": "measure", "Computation.digest": "measure"},
    "robustflow.run.store": {"RunFolder.write_rows": "write rows", "RunFolder.pack": "write rows"},
    "robustflow.run.costs": {"keep_cost": "cost of the model"},
    "robustflow.run.displacement": {"keep_displacement": "displacements"},
    "robustflow.pictures.panel": {"draw_panel": "pictures: panels"},
    "robustflow.pictures.examples": {"write_examples": "pictures: rest"},
    "robustflow.report.site.page": {"draw_figures": "page: figures", "write_report": "page: rest"},
    "robustflow.cli.tables": {"print_result": "table"},
}
"""The timed functions: module -> function -> name in the report, as a format string for the function's arguments."""

ROWS = ("sample", "corruption", "lens tables", "model: predict", "measure")
"""The parts that rows need, by the beginning of their names."""


class Probe:
    """CPU seconds of this process's main thread by part, saved to a file repeatedly."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._begin()
        os.register_at_fork(after_in_child=self._begin)

    def _begin(self) -> None:
        self._file = self._folder / f"{os.getpid()}.json"
        self._parts: dict[str, float] = {}
        self._inner = [0.0]
        self._written = 0.0

    def timed(self, function: Callable[..., Any], name: Callable[..., str]) -> Callable[..., Any]:
        """Wrap the function so that its time is recorded under the name that `name` returns for its arguments."""

        def call(*arguments: Any, **options: Any) -> Any:
            start = time.thread_time()
            self._inner.append(0.0)
            try:
                return function(*arguments, **options)
            finally:
                spent = time.thread_time() - start
                part = name(*arguments)
                inner = self._inner.pop()
                if self._inner:  # empty in a process that was forked within this call
                    self._parts[part] = self._parts.get(part, 0.0) + spent - inner
                    self._inner[-1] += spent
                if len(self._inner) == 1:
                    self._write()

        return call

    def _write(self) -> None:
        now = time.process_time()
        if now - self._written > 0.02:  # a worker is terminated by a signal, so it cannot write later
            self._written = now
            self._file.write_text(json.dumps({"parts": self._parts, "total": now}))

    def start(self) -> None:
        """Start timing imports, and the functions in `PARTS` as soon as their modules are imported."""
        from importlib import machinery

        for loader in (machinery.SourceFileLoader, machinery.ExtensionFileLoader):
            loader.exec_module = self._counting(loader.exec_module)  # type: ignore[method-assign]
        machinery.ExtensionFileLoader.create_module = self.timed(  # type: ignore[method-assign]
            machinery.ExtensionFileLoader.create_module, lambda loader, spec: f"import {spec.name.partition('.')[0]}"
        )

    def _counting(self, load: Callable[..., Any]) -> Callable[..., Any]:
        timed = self.timed(load, lambda loader, module: f"import {module.__name__.partition('.')[0]}")

        def load_counted(loader: Any, module: Any) -> None:
            timed(loader, module)
            for path, name in PARTS.get(module.__name__, {}).items():
                *owner, attribute = path.split(".")
                holder = getattr(module, owner[0], None) if owner else module
                if hasattr(holder, attribute):  # a different version may lack it
                    setattr(holder, attribute, self.timed(getattr(holder, attribute), name.format))

        return load_counted


def run(model: str, source: Path, folder: Path, reports: Path) -> tuple[float, float, list[dict[str, Any]]]:
    """Run the command with its caches in `folder`; return wall-clock and CPU seconds, and the processes' reports."""
    import ctypes
    import resource
    import shutil
    import subprocess

    shutil.rmtree(folder / "run", ignore_errors=True)
    reports.mkdir(parents=True)
    hook = folder / "hook"
    hook.mkdir(parents=True, exist_ok=True)
    (hook / "sitecustomize.py").write_text(Path(__file__).read_text())
    caches = {"XDG_CACHE_HOME": "cache", "MPLCONFIGDIR": "matplotlib", "NUMBA_CACHE_DIR": "numba"}
    ignored = ("_NUM_THREADS", "PYTHONDONTWRITEBYTECODE")  # an installed package has been compiled to bytecode
    environment = {name: value for name, value in os.environ.items() if not name.endswith(ignored)} | {
        "PYTHONPATH": f"{hook}{os.pathsep}{source}",
        REPORTS: str(reports),
        "ROBUSTFLOW_CACHE": str(folder / "cache"),
        **{name: str(folder / part) for name, part in caches.items()},
    }
    which = [sys.executable, "-c", "import robustflow; print(robustflow.__file__)"]
    used = subprocess.run(which, env=environment, cwd=folder, capture_output=True, text=True).stdout.strip()
    if not used.startswith(f"{source}{os.sep}"):
        sys.exit(
            f"this Python interpreter imports {used or 'no robustflow'} instead of the version in {source}; "
            "use an environment without it"
        )
    command = [sys.executable, "-m", "robustflow", "run", "--model", model, "--output", str(folder / "run")]
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)  # processes that outlive the command are counted, too
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)
    with suppress(ChildProcessError):
        while os.wait():  # the process from which the workers were forked
            pass
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"the command failed:\n{done.stderr}")
    cpu = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return wall, cpu, [json.loads(path.read_text()) for path in sorted(reports.glob("*.json"))]


def rows_cost(processes: list[dict[str, Any]]) -> float:
    """Return the CPU seconds that the rows take, in the workers if there are any."""
    workers = [one for one in processes if "write rows" not in one["parts"] and "measure" in one["parts"]] or processes
    return sum(spent for one in workers for name, spent in one["parts"].items() if name.startswith(ROWS))


def print_parts(processes: list[dict[str, Any]], top: int) -> None:
    """Print the parts of all processes, largest first; for each kind, parts beyond the first `top` are combined in one
    line."""
    parts: dict[str, list[float]] = {}
    for number, process in enumerate(processes):
        rest = process["total"] - sum(process["parts"].values())
        for name, spent in (process["parts"] | {"the rest: startup, library threads": rest}).items():
            parts.setdefault(name, [0.0] * len(processes))[number] += spent
    kinds: dict[str, list[tuple[str, list[float]]]] = {}
    for name, spent in parts.items():
        kinds.setdefault("import" if name.startswith("import ") else name.partition(":")[0], []).append((name, spent))
    sums = {
        kind: [sum(each) for each in zip(*(spent for _, spent in lines), strict=True)] for kind, lines in kinds.items()
    }
    for kind in sorted(kinds, key=lambda kind: -sum(sums[kind])):
        print(_line(kind, sums[kind]))
        if len(kinds[kind]) > 1:
            lines = sorted(kinds[kind], key=lambda line: -sum(line[1]))
            for name, spent in lines[:top]:
                print(_line(f"    {name}", spent))


def _line(name: str, spent: list[float]) -> str:
    return f"{name:<44}{sum(spent):7.2f}  " + "".join(f"{each:7.2f}" for each in spent)


def main() -> None:
    import argparse
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="dis")
    parser.add_argument("--rounds", type=int, default=1, help="warm runs of each version")
    parser.add_argument(
        "--top", type=int, default=12, help="number of parts to print of each kind (packages, functions, corruptions)"
    )
    parser.add_argument(
        "--against", type=Path, help="folder with a different version of `robustflow`, run alternately with this one"
    )
    options = parser.parse_args()
    sources = {"here": Path(__file__).resolve().parents[1] / "src"}
    if options.against is not None:
        sources = {"against": options.against.resolve()} | sources
    with tempfile.TemporaryDirectory(prefix="first-command-") as scratch:
        for number, kind in enumerate(["cold"] + ["warm"] * options.rounds):
            for name, source in sources.items():
                folder = Path(scratch) / name
                wall, cpu, processes = run(options.model, source, folder, folder / f"reports{number}")
                label = f"{kind}, {name}: " if len(sources) > 1 else f"{kind}: "
                print(
                    f"{label}{wall:.1f} s wall clock, {cpu:.1f} s of CPU time in {len(processes)} processes, "
                    f"{cpu / rows_cost(processes):.2f} times the cost of its rows",
                    flush=True,
                )
                if name == "here" and number in (0, options.rounds):
                    print_parts(processes, options.top)


if __name__ == "sitecustomize" and REPORTS in os.environ:
    Probe(Path(os.environ[REPORTS])).start()
elif __name__ == "__main__":
    main()
