"""Check that tests ran in each of several folders: `python -m tests.rooms REPORT FOLDER...`.

Reads a report that pytest wrote with `--junitxml`. If a library cannot be imported, all tests of a folder may skip, and
pytest reports success. Only the shared data may be absent.
"""

import sys
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from .shared_data import shared_root


def silent_folders(report: Path, folders: Iterable[str]) -> list[str]:
    """Describe each folder in which no test ran, unless all its tests need the shared data, which are absent."""
    reasons: dict[str, list[str | None]] = {folder: [] for folder in folders}
    for case in ElementTree.parse(report).iter("testcase"):
        name = f"{case.get('classname')}.{case.get('name')}".strip(".").replace(".", "/")
        skipped = case.find("skipped")
        for folder in reasons:
            if name.startswith(f"{folder}/"):
                reasons[folder].append(None if skipped is None else str(skipped.get("message")))
    silent = []
    for folder, found in reasons.items():
        excused = not shared_root().exists() and all(str(reason).startswith("shared data '") for reason in found)
        if not found:
            silent.append(f"{folder}: no test was collected")
        elif None not in found and not excused:
            silent.append(f"{folder}: all {len(found)} tests were skipped: {'; '.join(sorted(set(map(str, found))))}")
    return silent


if __name__ == "__main__":
    silent = silent_folders(Path(sys.argv[1]), sys.argv[2:])
    sys.exit("\n".join(silent) or 0)
