"""Measure the peak memory and time for averaging a run of a million rows, as `run` does at the end.

    python bench/averaging.py [--pairs 9901]

The script generates a run with every image-pair corruption at every severity (101 rows per pair), in shards of the same
size as those that `run` writes. A separate process then computes the means; the script also prints the memory use of
this process before it reads the run.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl
from synthetic_runs import synthetic_runs

from robustflow.run.run import Run
from robustflow.run.store import RunFolder, list_shards, read_shard, write_shard

SHARD = 100
"""Number of pairs in a shard."""

_AVERAGE = """
import hashlib, json, pathlib, re, sys, time
from robustflow.run.run import Run
status = pathlib.Path("/proc/self/status")  # `getrusage` would count the memory of the process that started this one
mib = lambda: int(re.search("VmHWM:(.*) kB", status.read_text())[1]) / 1024
run, before, start = Run(sys.argv[1]), mib(), time.perf_counter()
text = json.dumps(run.document())
print(f"{mib():.0f} MiB at most, {before:.0f} MiB before, {time.perf_counter() - start:.1f} s, "
      f"means {hashlib.sha256(text.encode()).hexdigest()[:12]}")
"""


def generate(folder: Path, pairs: int) -> Path:
    """Write a run of `pairs` pairs by copying the rows of a small run and scaling the sums in each row by a
    different factor.
    """
    (small,) = synthetic_runs(folder, 1, SHARD)
    run, rng = Run(small), np.random.default_rng(0)
    rows, keys = run.rows, sorted(run.manifest.samples)
    files = run.manifest.samples[keys[0]]
    names = [f"{index:06d}" for index in range(pairs)]
    target = RunFolder(folder / "large")
    target.rows_folder.mkdir(parents=True)
    planned = tuple(part.model_copy(update={"samples": tuple(names)}) for part in run.manifest.planned)
    samples = dict.fromkeys(names, files)
    target.write_manifest(run.manifest.model_copy(update={"samples": samples, "planned": planned}))
    sums = [name for name, kind in rows.schema.items() if kind == pl.Float64]
    for first in range(0, pairs, SHARD):
        mine = dict(zip(keys, names[first : first + SHARD], strict=False))
        part = rows.filter(pl.col("sample").is_in([*mine])).with_columns(
            pl.col("sample", "group").replace(mine), pl.concat_str("sample", "frames_digest").alias("frames_digest")
        )
        factor = pl.Series(rng.lognormal(0, 0.5, part.height))
        write_shard(target.rows_folder, f"pack{first}", part.with_columns(pl.col(name) * factor for name in sums))
    return target.path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=9901, help="101 rows each (9901: a million rows)")
    parser.add_argument("--run", type=Path, help="run folder to average instead of a generated run")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = options.run or generate(Path(folder), options.pairs)
        shards = list_shards(path / "rows")
        rows = sum(read_shard(shard, ["sample"]).height for shard in shards)
        size = sum(shard.stat().st_size for shard in shards) / 2**20
        print(f"{rows} rows in {len(shards)} shards, {size:.0f} MiB", flush=True)
        subprocess.run([sys.executable, "-c", _AVERAGE, str(path)], check=True)


if __name__ == "__main__":
    main()
