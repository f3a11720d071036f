"""Rewrite all stored files that are computed from the code: `python -m tests.rewrite`.

These are the hashes that `robustflow corrupt --check` compares, the golden runs and frames, and the public names.
Results of long searches are not among them: `robustflow optics design` finds lenses, and
`bench/calibrated_severities.py` severities.
"""

import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from robustflow.corruptions import machine_check
from robustflow.corruptions.registry import CLIP
from robustflow.data.video import machine_check as clips

from .golden import corrupted
from .golden.record import STORED as GOLDEN
from .golden.record import golden_text
from .public_surface import STORED, surface, without_torch


def stored_files() -> Iterator[tuple[Path, str]]:
    """Yield the path and the new content of each file."""
    with tempfile.TemporaryDirectory() as scratch:
        pairs = {name: machine_check.digests_of(name) for name in machine_check.CHECKED}
        yield Path(str(machine_check.DIGESTS)), json.dumps(pairs, indent=1) + "\n"
        clip = clips.prepared_clip(Path(scratch))
        yield (
            Path(str(clips.DIGESTS)),
            json.dumps({name: clips.digests_of(name, clip) for name in CLIP}, indent=1) + "\n",
        )
        yield corrupted.STORED, corrupted.corrupted_text()
        yield GOLDEN, golden_text(Path(scratch) / "golden")
        yield STORED, "\n".join(sorted({*surface(), *without_torch()})) + "\n"


if __name__ == "__main__":
    for path, content in stored_files():
        changed = content != path.read_text(encoding="utf-8")
        path.write_text(content, encoding="utf-8")
        sys.stdout.write(f"{path}: {'changed' if changed else 'unchanged'}\n")
