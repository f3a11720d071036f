"""Requirements for every registered pair corruption, the paper's numbers, and the bytes on any machine."""

import json
import os
import pickle
import platform
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow
from robustflow.core.errors import AssetError
from robustflow.core.rng import Rng
from robustflow.corruptions import corrupt, load_corruption, machine_check
from robustflow.corruptions.corruption import VARIANTS
from robustflow.corruptions.registry import CLIP, CORRUPTIONS, FURTHER, PAPER_ORDER
from robustflow.data.video import machine_check as clips

from ..golden.corrupted import differences
from .pictures import picture, scene

NAMES = [name for name in CORRUPTIONS.names() if name not in CLIP]
every_corruption = pytest.mark.parametrize("name", NAMES)


def corrupted(*args, **options):
    """Call `corrupt` with depth; skip the test if textures or lenses are missing and cannot be downloaded."""
    try:
        return corrupt(*args, **options, depth=scene(*args[0].shape[:2]))
    except AssetError as error:
        pytest.skip(str(error))


@every_corruption
@settings(max_examples=8)
@given(
    size=st.tuples(st.integers(1, 90), st.integers(1, 90)) | st.sampled_from([(2, 400), (400, 3)]),
    severity=st.integers(1, 5),
    variant=st.sampled_from(VARIANTS),
    seed=st.integers(0, 2**32),
    value=st.sampled_from([0, 255]),
)
def test_every_corruption_keeps_the_contract(name, size, severity, variant, seed, value):
    frames = [picture(*size, seed=0), picture(*size, seed=1), np.full((*size, 3), value, np.uint8)]
    untouched = [frame.copy() for frame in frames]
    options = {"seed": seed, "key": "k", "variant": variant}
    pair, other_second = (corrupted(frames[0], frame, name, severity, **options) for frame in frames[1:])
    for out in (*pair, *other_second):
        assert out.shape == (*size, 3)
        assert out.dtype == np.uint8
        assert out.flags.c_contiguous
        assert not any(np.shares_memory(out, frame) for frame in frames)
    assert all((frame == before).all() for frame, before in zip(frames, untouched, strict=True))

    again = corrupted(frames[0], frames[1], name, severity, **options)
    assert all((out == other).all() for out, other in zip(pair, again, strict=True)), "different bytes for the same key"

    assert (other_second[0] == pair[0]).all(), "frame 1 depends on frame 2"


@every_corruption
def test_views_and_read_only_frames_are_accepted(name):
    whole = picture(70, 101)
    strided, reverse = whole[1:61:2, 3:99:3], picture(40, 50)[::-1, ::-1, ::-1]
    read_only = picture(40, 50, seed=1)
    read_only.setflags(write=False)
    fortran = np.asfortranarray(picture(33, 47))
    for frame in (strided, reverse, read_only, fortran):
        expected = corrupted(frame.copy(order="C"), frame.copy(order="C"), name, 3)
        found = corrupted(frame, frame, name, 3)
        assert all((out == other).all() for out, other in zip(found, expected, strict=True))


@pytest.mark.parametrize("name", FURTHER["depth"])
def test_layout_of_depth_maps_changes_no_byte(name):
    frame, depth = picture(60, 90), scene(60, 90)
    wide = np.zeros((60, 180), np.float32)
    wide[:, ::2] = depth.maps[1]
    turned = replace(depth, maps=(np.asfortranarray(depth.maps[0]), wide[:, ::2]))
    assert np.array_equal(corrupt(frame, frame, name, 4, depth=turned), corrupt(frame, frame, name, 4, depth=depth))


@every_corruption
def test_a_pickled_state_gives_the_same_frames_in_any_order(name):
    frame, corruption = picture(40, 50), load_corruption(name)
    state = corruption.draw_with_depth(Rng.of("contract", name), 4, frame.shape[:2], scene(*frame.shape[:2]))
    try:
        out = [corruption.apply(frame, state, index) for index in (0, 1)]
    except AssetError as error:
        pytest.skip(str(error))
    again = pickle.loads(pickle.dumps(state))
    assert np.array_equal([corruption.apply(frame, again, index) for index in (1, 0)], out[::-1])


@every_corruption
def test_threads_share_an_instance(name):
    corruption, frames = load_corruption(name), [picture(60, 75, seed=i) for i in range(6)]
    expected = [corrupted(frame, frame, corruption, 2, key=str(i)) for i, frame in enumerate(frames)]
    with ThreadPoolExecutor(3) as pool:
        jobs = [pool.submit(corrupted, frame, frame, corruption, 2, key=str(i)) for i, frame in enumerate(frames)]
        for job, pair in zip(jobs, expected, strict=True):
            assert all((out == other).all() for out, other in zip(job.result(), pair, strict=True))


@pytest.mark.slow
@every_corruption
@pytest.mark.parametrize("size", [(2160, 4096), (1999, 61), (17, 3001)])
def test_large_and_elongated_frames_are_corrupted(name, size):
    frame = picture(*size)
    for out in corrupted(frame, frame, name, 5):
        assert out.shape == frame.shape
        assert out.dtype == np.uint8


PAPER = {
    "h264_crf": (23, 30, 37, 44, 51),
    "h264_abr": (25e6, 12.5e6, 6.25e6, 3.125e6, 1.5625e6),
    "bit_error": (50e6, 25e6, 15e6, 10e6, 1e6),
}
"""Severities of the corruptions that the reference folder lacks."""


def test_this_machine_gives_the_bytes_of_the_packages_digests():
    assert differences() == {}


OLDEST = {
    "NUMBA_CPU_NAME": "x86-64",
    "NUMBA_CPU_FEATURES": "",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX512-ICL,AVX2,AVX,FMA3,SSE4.2,SSE4.1",
    "JSIMD_FORCENONE": "1",
}
WITH_SSE2 = """
import ctypes
import av
used = (line.split()[-1] for line in open("/proc/self/maps") if "libavutil" in line)
ctypes.CDLL(next(used)).av_force_cpu_flags(0b11011)  # MMX, MMX2, SSE and SSE2
from tests.golden.corrupted import differences
print(differences())
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="tests the baseline x86-64 instructions")
def test_oldest_instructions_give_the_same_bytes(tmp_path):
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, **OLDEST, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": root}
    done = subprocess.run(
        [sys.executable, "-c", WITH_SSE2], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "{}\n"


class _NotToBeUsed:
    """Replaces a random generator; any use of it is an error."""

    def __getattribute__(self, name):
        raise AssertionError(f"the generator is used: {name}")


FIXED = (
    *("jpeg_compression", "pixelate", "contrast", "saturate", "high_light", "low_light", "gaussian_blur"),
    *("defocus_blur", "psf_blur", "near_focus", "far_focus", "motion_blur_3d"),
)
"""Pair corruptions without any random parameter; the motion of `scene` is known."""


@every_corruption
def test_keys_seeds_and_severities_change_what_is_drawn(name):
    frame = picture(64, 80)
    levels = {b"".join(out.tobytes() for out in corrupted(frame, frame, name, level)) for level in range(1, 6)}
    assert len(levels) == 5
    if name in FIXED:
        corruption = load_corruption(name)
        state = corruption.draw_with_depth(_NotToBeUsed(), 3, (64, 80), scene(64, 80))
        corruption.apply(frame, state, 1)
        return
    keys = {b"".join(out.tobytes() for out in corrupted(frame, frame, name, 3, key=str(key))) for key in range(12)}
    seeds = {b"".join(out.tobytes() for out in corrupted(frame, frame, name, 3, seed=seed)) for seed in range(12)}
    # there are only two choices for the exposed frame, and similar blur directions may coincide
    least = 2 if name.endswith("exposure") else 9
    assert len(keys) >= least
    assert len(seeds) >= least


def test_registered_classes_have_the_names_severities_and_parameters_of_the_paper():
    for name in CORRUPTIONS.names():
        kind = CORRUPTIONS.get(name)
        assert (kind.name, kind.__name__) == (name, "".join(word.capitalize() for word in name.split("_")))
        assert kind.__doc__
        assert load_corruption(name).severities == PAPER.get(name, kind.paper_severities)
        for scale in ("paper", "calibrated"):
            for value in load_corruption(name, scale=scale).severities:
                assert not isinstance(value, tuple) or value._fields, name
    assert [name for name in PAPER_ORDER if load_corruption(name).temporal] == [
        *("over_exposure", "under_exposure", "snow", "camera_motion_blur", "object_motion_blur"),
        *("h264_crf", "h264_abr", "bit_error"),
    ]
    stored = [set(json.loads(module.DIGESTS.read_text())) for module in (machine_check, clips)]
    assert stored == [set(machine_check.CHECKED), set(CLIP)]


def test_planted_corruption_costs_one_file_and_one_line(tmp_path):
    """A copy of the package in which one family has a new file and the registry one more line."""
    package = Path(robustflow.__file__).parent
    shutil.copytree(package, tmp_path / "robustflow", ignore=shutil.ignore_patterns("__pycache__", "*.csv"))
    planted = tmp_path / "robustflow" / "corruptions"
    (planted / "sensor" / "dead_rows.py").write_text(PLANTED)
    registry = planted / "registry.py"
    line = '    "sensor": {"raw_noise": "sensor.raw_noise", '
    assert line in registry.read_text()
    registry.write_text(registry.read_text().replace(line, line + '"dead_rows": "sensor.dead_rows", '))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", USED], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["dead_rows", "sensor", "0"], done.stderr


PLANTED = """
from ..corruption import Corruption

class DeadRows(Corruption):
    name = "dead_rows"
    paper_severities = (2, 3, 5, 8, 13)

    def apply(self, frame, state, index):
        out = frame.copy()
        out[::16 - state] = 0
        return out
"""
USED = """
import numpy as np
from robustflow.corruptions import corrupt, list_corruptions
from robustflow.corruptions.registry import FURTHER
from robustflow.testing import check_corruption
grey = np.full((32, 48, 3), 9, np.uint8)
print(check_corruption("dead_rows"), *(f for f, names in FURTHER.items() if "dead_rows" in names))
print(corrupt(grey, grey, "dead_rows", 3)[1].min())
"""
