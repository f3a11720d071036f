"""Test frost without photographs: generated textures, and that the README's first command needs no network."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import AssetError
from robustflow.core.types import Sample
from robustflow.corruptions import load_corruption
from robustflow.corruptions.weather.frost import STYLES, generated_texture, photograph
from robustflow.corruptions.weather.frost_photographs import FOLDER_VARIABLE
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.benchmarks.demo import DEMO_CLASSES
from robustflow.data.benchmarks.export import export
from robustflow.media.images import read_image, write_image
from robustflow.run.frame_stage import FrameStage, frames_digest
from robustflow.run.seconds import no_seconds
from robustflow.run.setup import set_up_frames
from robustflow.testing import ZeroFlow

OFFLINE = """
import sys
def refuse(event, arguments):
    connects = event in ("socket.connect", "socket.getaddrinfo", "socket.sendto")
    if connects or (event == "subprocess.Popen" and "pip" in arguments[1]):
        raise AssertionError(f"{event} {arguments}")
sys.addaudithook(refuse)
from robustflow.cli.main import main
for command in sys.argv[1:]:
    sys.argv = ["robustflow", *command.split()]
    try:
        main()
    except SystemExit as stop:
        if stop.code:
            raise
"""
"""Run commands until one fails; any connection or call to pip is an error."""


@pytest.fixture
def no_photographs(monkeypatch, tmp_path):
    """Simulate a machine without the photographs: every request for a photograph fails, even if other tests have
    used it.
    """
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    photograph.cache_clear()


def offline(tmp_path, *commands):
    places = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "ROBUSTFLOW_CACHE"), str(tmp_path / "home"))
    left = {name: value for name, value in os.environ.items() if name != FOLDER_VARIABLE}
    command = [sys.executable, "-c", OFFLINE, *commands]
    return subprocess.run(command, cwd=tmp_path, env=left | places, capture_output=True, text=True, timeout=900)


def test_demo_runs_without_network_and_without_pip(tmp_path):
    """The same corruption on a user's frames requires the photographs, so it shows that the check works."""
    for name, frame in zip(("a.png", "b.png"), load_benchmark("demo").dataset.load("motorcycle").frames, strict=True):
        write_image(tmp_path / name, frame[:64, :64])
    done = offline(tmp_path, "run --model dis -c frost -s 3 --no-examples", "corrupt a.png b.png -c frost -s 1")
    (folder,) = tmp_path.glob("runs/*")
    assert rf.load_run(folder).measured.complete, done.stderr
    assert done.returncode != 0
    assert "subprocess.Popen" in done.stderr


@pytest.mark.slow
def test_the_first_command_and_a_leaderboard_without_runs_need_no_network(tmp_path):
    done = offline(tmp_path, "run --model dis", "leaderboard -o site")
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("runs/*/manifest.json"))
    assert '"shots":{"1":' in (tmp_path / "site/index.html").read_text()


def test_generated_textures_have_the_stored_digest():
    pictures = [generated_texture(slot) for slot in range(len(STYLES))]
    digest = hashlib.sha256(b"".join(picture.tobytes() for picture in pictures)).hexdigest()
    assert digest[:16] == "15ae25f6f56727b2"
    for picture, style in zip(pictures, STYLES, strict=True):
        grey = picture.mean(axis=2)
        assert abs(grey.mean() - style.mean) < 3
        assert abs(grey.std() - style.spread) < 1.5
        fineness = np.abs(np.diff(grey, axis=1)).mean()
        assert 7 < fineness < 21  # values for the photographs: 7.4, 7.9, 7.9, 13.2, 17.4


def test_frost_of_the_demo_mixes_generated_textures_alone_in_stacks_and_in_bgr(no_photographs):
    grey = np.full((90, 130, 3), 100, np.uint8)
    frost = load_corruption("frost", classes=DEMO_CLASSES)
    first, second = rf.corrupt(grey, grey, frost, 3, seed=4)
    assert np.array_equal(first, second)
    assert first.std() > 5
    assert not np.array_equal(first, rf.corrupt(grey, grey, frost, 3, seed=5)[0])
    for name in ("fog+frost", "frost"):
        for variant in ("default", "reference-bgr"):
            rf.corrupt(grey, grey, load_corruption(name, variant, classes=DEMO_CLASSES), 2)
            with pytest.raises(AssetError, match="not found in"):
                rf.corrupt(grey, grey, load_corruption(name, variant), 2)


def test_frost_outside_the_demo_needs_the_photographs(no_photographs, tmp_path):
    motorcycle = load_benchmark("motorcycle").narrowed(["frost"], [1])
    with pytest.raises(AssetError, match="not found in"):
        rf.evaluate(ZeroFlow(), motorcycle, output=tmp_path / "run")


def test_frames_of_a_demo_run_made_again_have_the_digest_of_its_rows(no_photographs, tmp_path):
    run = rf.evaluate(ZeroFlow(), "demo", output=tmp_path / "run", corruptions="frost", severities=2)
    dataset, options = set_up_frames(run.manifest.identity, None, {})
    frames = FrameStage(dataset, options, no_seconds()).corrupt(dataset.load("motorcycle"), "frost", 2)
    (row,) = run.rows.filter(corruption="frost").to_dicts()
    assert frames_digest(frames) == row["frames_digest"]


def test_an_export_of_the_demonstration_holds_the_frames_of_its_run(no_photographs, tmp_path):
    demo = load_benchmark("demo").narrowed(["frost"], [2])
    list(export(demo, tmp_path / "out"))
    sample: Sample = demo.dataset.load("motorcycle")
    frost = load_corruption("frost", classes=DEMO_CLASSES)
    frame = rf.corrupt(*sample.frames, frost, 2, key="motorcycle")[0]
    assert np.array_equal(read_image(tmp_path / "out/frost_2/val/image_2/motorcycle_10.png"), frame)
