"""The drive in which each pair of KITTI's training sets was recorded; pairs of the same drive are not independent.

    data/kitti2015_drives.csv   pair, drive, frame of the raw data: 142 of the 200 pairs, 29 drives
    data/kitti2012_drives.csv   89 of the 194 pairs, 16 drives

The numbers for 2015 are from `mapping/train_mapping.txt` in the benchmark's development kit (Menze and Geiger, CVPR
2015), whose lines are empty if the drive is not in the public raw data. For 2012 there is no official table; ours lists
the pairs that Meister, Hur and Roth (UnFlow, AAAI 2018) found in the raw data in order to exclude them from training.

**Pairs without a drive.** The pairs of 2015 are numbered in the order of drives, and the raw data contain either all of
a drive or none of it. Consecutive pairs without a drive therefore do not share a drive with the pairs before and after
them, although the number of drives among them is unknown. Such a block of pairs forms one group, so too many pairs
may be treated as related, but never too few. The pairs of 2012 are numbered at random, so neighbours carry no
information and all pairs without a drive form one group; confidence intervals on 2012 are still too narrow
(`docs/design/uncertainty.md`).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from itertools import groupby

_TABLES = {
    "kitti2015": ("kitti2015", 200),
    "kitti_fc_released": ("kitti2015", 200),
    "kitti2012": ("kitti2012", 194),
}
"""Table of pairs and number of pairs for each dataset. The released KITTI-FC keeps the numbering of 2015."""

_NUMBERED_BY_DRIVE = ("kitti2015",)


@cache
def drives(dataset: str) -> Mapping[str, str]:
    """Return the drive of each pair whose drive is known; empty for datasets other than KITTI's."""
    if dataset not in _TABLES:
        return {}
    table = files("robustflow.datasets") / "data" / f"{_TABLES[dataset][0]}_drives.csv"
    return {line["pair"]: line["drive"] for line in csv.DictReader(table.read_text(encoding="utf-8").splitlines())}


@cache
def drive_groups(dataset: str) -> Mapping[str, str]:
    """Return the group of each pair: its drive or a substitute; empty for datasets other than KITTI's."""
    if dataset not in _TABLES:
        return {}
    table, count = _TABLES[dataset]
    known, pairs = drives(dataset), [f"{number:06d}" for number in range(count)]
    groups: dict[str, str] = {}
    for has_drive, run in groupby(pairs, key=known.__contains__):
        members = list(run)
        if has_drive:
            groups |= {pair: known[pair] for pair in members}
        elif table in _NUMBERED_BY_DRIVE:
            groups |= dict.fromkeys(members, "_".join(("unmapped", *dict.fromkeys((members[0], members[-1])))))
        else:
            groups |= dict.fromkeys(members, "unmapped")
    return groups


def related(first: Iterable[str], second: Iterable[str]) -> list[str]:
    """Return the pairs of KITTI 2015 in `first` that come from the same known drive as a pair in `second`, in the order
    of `first`.
    """
    known = drives("kitti2015")
    others = {known[pair] for pair in second if pair in known}
    return [pair for pair in first if known.get(pair) in others]
