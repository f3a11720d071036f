"""Frost without photographs: the textures, and that the README's first command asks the network for nothing."""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import robustflow as rf
from robustflow.benchmarks import load_benchmark
from robustflow.benchmarks.export import export
from robustflow.corruptions import load_corruption
from robustflow.corruptions.weather import frost_textures
from robustflow.corruptions.weather.frost_assets import FOLDER_VARIABLE
from robustflow.corruptions.weather.generated_frost import STYLES, generated_texture
from robustflow.errors import AssetError, RunError, UsageError
from robustflow.images.io import read_image, write_image
from robustflow.runner.setup import set_up, set_up_frames
from robustflow.sample import Sample
from robustflow.testing import ZeroFlow

OFFLINE = """
import sys
def refuse(event, arguments):
    connects = event in ("socket.connect", "socket.getaddrinfo", "socket.sendto")
    if connects or (event == "subprocess.Popen" and "pip" in arguments[1]):
        raise AssertionError(f"{event} {arguments}")
sys.addaudithook(refuse)
sys.argv = ["robustflow", *sys.argv[1:]]
from robustflow.cli.main import main
main()
"""
"""The command line, where a connection or a call of pip is an error."""


@pytest.fixture
def no_photographs(monkeypatch, tmp_path):
    """A machine without the photographs; whoever asks for one is refused, also where other tests had them."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    frost_textures.texture.cache_clear()


def offline(tmp_path, *arguments):
    places = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "ROBUSTFLOW_CACHE"), str(tmp_path / "home"))
    left = {name: value for name, value in os.environ.items() if name != FOLDER_VARIABLE}
    command = [sys.executable, "-c", OFFLINE, *arguments]
    return subprocess.run(command, cwd=tmp_path, env=left | places, capture_output=True, text=True, timeout=900)


@pytest.mark.parametrize(
    "asked", [("-c", "frost", "-s", "3", "--no-examples"), pytest.param((), marks=pytest.mark.slow)]
)
def test_the_first_command_needs_no_network(tmp_path, asked):
    done = offline(tmp_path, "run", "--model", "dis", *asked)
    assert done.returncode == 0, done.stderr
    (manifest,) = tmp_path.glob("runs/*/manifest.json")
    assert json.loads(manifest.read_text())["identity"]["frost"] == "generated 1"


@pytest.mark.slow
def test_a_leaderboard_without_runs_needs_no_network(tmp_path):
    done = offline(tmp_path, "leaderboard", "-o", "site")
    assert done.returncode == 0, done.stderr
    assert '"shots":{"1":' in (tmp_path / "site/index.html").read_text()


def test_what_is_refused_offline_would_be_noticed(tmp_path):
    """The guard above refuses what fetches: the same corruption of the user's own frames, with the photographs."""
    for name, frame in zip(("a.png", "b.png"), load_benchmark("demo").dataset.load("motorcycle").frames, strict=True):
        write_image(tmp_path / name, frame[:64, :64])
    done = offline(tmp_path, "corrupt", "a.png", "b.png", "-c", "frost", "-s", "1")
    assert done.returncode != 0
    assert "subprocess.Popen" in done.stderr


def test_the_textures_are_the_same_everywhere():
    pictures = [generated_texture(slot) for slot in range(len(STYLES))]
    digest = hashlib.sha256(b"".join(picture.tobytes() for picture in pictures)).hexdigest()
    assert digest[:16] == "15ae25f6f56727b2"
    for picture, style in zip(pictures, STYLES, strict=True):
        grey = picture.mean(axis=2)
        assert abs(grey.mean() - style.mean) < 3
        assert abs(grey.std() - style.spread) < 1.5
        fineness = np.abs(np.diff(grey, axis=1)).mean()
        assert 7 < fineness < 21  # of the photographs: 7.4, 7.9, 7.9, 13.2, 17.4


def test_frost_is_the_same_mixture_of_other_textures(no_photographs):
    grey = np.full((90, 130, 3), 100, np.uint8)
    frost = load_corruption("frost").with_textures("generated")
    first, second = rf.corrupt(grey, grey, frost, 3, seed=4)
    assert np.array_equal(first, second)
    assert first.std() > 5
    assert not np.array_equal(first, rf.corrupt(grey, grey, frost, 3, seed=5)[0])
    for name in ("fog+frost", "frost"):
        for variant in ("default", "reference-bgr"):
            rf.corrupt(grey, grey, load_corruption(name, variant).with_textures("generated"), 2)
            with pytest.raises(AssetError, match="not found in"):
                rf.corrupt(grey, grey, load_corruption(name, variant), 2)
    assert load_corruption("fog").with_textures("generated").name == "fog"
    with pytest.raises(UsageError, match="unknown frost textures 'drawn'"):
        load_corruption("frost").with_textures("drawn")


def test_runs_with_other_textures_are_never_one_run(no_photographs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chosen = {"corruptions": ["contrast"], "severities": [1], "examples": False}
    demo = load_benchmark("demo")
    photographs = replace(demo, textures="photographs")
    run = rf.evaluate(ZeroFlow(), "demo", output=tmp_path / "generated", **chosen)
    assert run.manifest["identity"]["frost"] == "generated 1"
    with pytest.raises(RunError, match="frost, whose textures were generated, and are photographs now"):
        rf.evaluate(ZeroFlow(), photographs, output=tmp_path / "generated", **chosen)
    before = rf.evaluate(ZeroFlow(), photographs, **chosen)
    assert "frost" not in before.manifest["identity"]  # as every run was recorded before textures could be chosen
    with pytest.warns(UserWarning, match="is not continued: it differs in: frost, .* a new run starts in"):
        now = rf.evaluate(ZeroFlow(), "demo", **chosen)
    assert now.path != before.path
    assert set_up_frames(before.manifest["identity"], None, {})[1].textures == "photographs"
    assert set_up_frames(now.manifest["identity"], None, {})[1].textures == "generated"


def test_other_benchmarks_keep_the_photographs(tmp_path):
    kept = replace(load_benchmark("demo"), textures="photographs", name="mine")
    assert set_up(ZeroFlow(), kept).options.textures == "photographs"
    assert "frost" not in set_up(ZeroFlow(), kept).plan.identity()


def test_an_export_of_the_demonstration_holds_the_frames_of_its_run(no_photographs, tmp_path):
    demo = load_benchmark("demo").narrowed(["frost"], [2])
    list(export(demo, tmp_path / "out"))
    assert json.loads((tmp_path / "out/export.json").read_text())["frost"] == "generated 1"
    sample: Sample = demo.dataset.load("motorcycle")
    frost = load_corruption("frost").with_textures("generated")
    frame = rf.corrupt(*sample.frames, frost, 2, key="motorcycle")[0]
    assert np.array_equal(read_image(tmp_path / "out/frost_2/val/image_2/motorcycle_10.png"), frame)
