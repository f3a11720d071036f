"""Corruptions produce the same bytes with this machine's instruction set as with a 2003 processor's."""

import json
import os
import platform
import subprocess
import sys

import pytest

from robustflow.corruptions import machine_check
from robustflow.corruptions.registry import CLIP
from robustflow.data.video import machine_check as clips

SCRIPT = """
import ctypes
import hashlib
import os
import tempfile
from pathlib import Path
import av
import cv2
from robustflow.corruptions import corrupt
from robustflow.corruptions.registry import CLIP, CORRUPTIONS
from robustflow.data.datasets.motorcycle import Motorcycle
from robustflow.core.errors import AssetError
from robustflow.core.types import SceneDepth
from robustflow.data.video import machine_check

if "FFMPEG_WITH_SSE2" in os.environ:
    used = (line.split()[-1] for line in open("/proc/self/maps") if "libavutil" in line)
    ctypes.CDLL(next(used)).av_force_cpu_flags(0b11011)  # MMX, MMX2, SSE and SSE2
cv2.setNumThreads(1)
part = slice(100, 221), slice(200, 387)
sample = Motorcycle().load("motorcycle")
frames, whole = [frame[part] for frame in sample.frames], Motorcycle().depth(sample)
maps, masks = ([each[part] for each in both] for both in (whole.maps, whole.measured))
depth = SceneDepth((10 * maps[0], 10 * maps[1]), tuple(masks), whole.camera)
for name in CORRUPTIONS.names():
    if name in CLIP:
        continue
    try:
        pairs = [corrupt(*frames, name, severity, seed=3, depth=depth) for severity in (1, 3, 5)]
    except AssetError:
        continue
    print(name, hashlib.sha256(b"".join(frame.tobytes() for pair in pairs for frame in pair)).hexdigest())
with tempfile.TemporaryDirectory() as folder:
    clip = machine_check.prepared_clip(Path(folder))
    for name in CLIP:
        print(name, "".join(machine_check.digests_of(name, clip).values()))
"""

OLDEST = {
    "NUMBA_CPU_NAME": "x86-64",
    "NUMBA_CPU_FEATURES": "",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX512-ICL,AVX2,AVX,FMA3,SSE4.2,SSE4.1",
    "JSIMD_FORCENONE": "1",
    "FFMPEG_WITH_SSE2": "1",
}


def digests(**environment):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=os.environ | environment, capture_output=True, text=True, check=True
    )
    return dict(line.split() for line in done.stdout.splitlines())


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="tests the baseline x86-64 instructions")
def test_oldest_instructions_give_the_same_bytes(tmp_path):
    here = digests()
    assert len(here) >= 24
    assert digests(NUMBA_CACHE_DIR=str(tmp_path), **OLDEST) == here


def test_stored_digests_cover_exactly_the_shipped_corruptions():
    stored = [set(json.loads(module.DIGESTS.read_text())) for module in (machine_check, clips)]
    assert stored == [set(machine_check.CHECKED), set(CLIP)]


@pytest.mark.slow  # compilation and computation take half a minute; psf_blur alone takes five seconds
def test_this_machine_gives_the_bytes_of_the_packages_digests():
    compared = dict(machine_check.compare_with_package()) | dict(clips.compare_with_package())
    assert len(compared) >= 26
    assert {name: what for name, what in compared.items() if what and not what.startswith("not compared")} == {}
