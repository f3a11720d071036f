"""Store digests of small corrupted pairs: every pair corruption, variant and severity, on frames of odd sizes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from robustflow.corruptions import corrupt, load_corruption, machine_check
from robustflow.corruptions.corruption import BGR, VARIANTS
from robustflow.data.benchmarks.paper import DEMO_CLASSES
from robustflow.data.video import machine_check as clips

from ..corruptions.pictures import picture, scene

STORED = Path(__file__).parent / "corrupted.json"
SIZES = {"default": (61, 87), "paper": (45, 70), "reference": (53, 33), BGR: (33, 53)}
"""Height and width of the frames of each variant; the demo's classes need no photographs of frost."""


def digests_of(name: str) -> dict[str, str]:
    """Return the digest of the pairs at severities 1 to 5 for each variant."""
    digests = {}
    for variant in (*VARIANTS, BGR):
        size, digest = SIZES[variant], hashlib.blake2b(digest_size=8)
        corruption = load_corruption(name, variant, classes=DEMO_CLASSES)
        for severity in range(1, 6):
            pair = corrupt(picture(*size), picture(*size, seed=1), corruption, severity, 3, depth=scene(*size))
            digest.update(b"".join(frame.tobytes() for frame in pair))
        digests[variant] = digest.hexdigest()
    return digests


def corrupted_text() -> str:
    """Corrupt everything again, and return the content of the stored file."""
    return json.dumps({name: digests_of(name) for name in machine_check.CHECKED}, indent=1) + "\n"


def differences():
    """Return what this machine makes otherwise than the digests of the package say, by corruption."""
    compared = {**dict(machine_check.compare_with_package()), **dict(clips.compare_with_package())}
    assert len(compared) >= 26
    return {name: what for name, what in compared.items() if what and not what.startswith("not compared")}
