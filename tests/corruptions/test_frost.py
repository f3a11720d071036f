"""Frost: where textures come from, how they are blended, and generated textures without a network."""

import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import AssetError, DataError
from robustflow.core.files import CACHE_VARIABLE, cache_folder
from robustflow.core.rng import Rng
from robustflow.core.types import Sample
from robustflow.corruptions import load_corruption
from robustflow.corruptions.weather import frost
from robustflow.corruptions.weather import frost_photographs as frost_assets
from robustflow.corruptions.weather.frost import (
    STYLES,
    Frost,
    enlarged_shape,
    enlarged_texture,
    generated_texture,
    photograph,
    resize_cubic,
)
from robustflow.corruptions.weather.frost_photographs import FOLDER_VARIABLE
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.benchmarks.export import export
from robustflow.data.benchmarks.paper import DEMO_CLASSES
from robustflow.media.images import read_image, write_image
from robustflow.run.repeat import recorded_plan
from robustflow.run.stages import FrameStage, Seconds, frames_digest
from robustflow.testing import ZeroFlow

from ..refusals import refusal


@pytest.fixture
def invented(monkeypatch, tmp_path):
    """Create five fake textures and replace the real hashes with theirs; neither an installed package nor pip is
    used.
    """
    folder = tmp_path / "textures"
    folder.mkdir()
    hashes = {}
    for slot, name in enumerate(frost_assets.TEXTURES):
        image = np.random.default_rng(slot).integers(0, 256, (40 + slot, 60, 3), dtype=np.uint8)
        content = cv2.imencode(".png", image)[1].tobytes()
        (folder / name).write_bytes(content)
        hashes[name] = hashlib.sha256(content).hexdigest()
    monkeypatch.setattr(frost_assets, "TEXTURES", hashes)
    monkeypatch.setattr(frost_assets, "find_spec", lambda name: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.delenv(frost_assets.FOLDER_VARIABLE, raising=False)
    clear_caches()
    yield folder
    clear_caches()


def clear_caches():
    photograph.cache_clear()
    frost._enlarged.clear()


@pytest.fixture
def pip(monkeypatch, invented):
    """Replaces pip: writes a wheel with fake textures to the download folder."""
    calls = []

    def download(command, **_):
        calls.append(command)
        with zipfile.ZipFile(Path(command[command.index("--dest") + 1]) / "it.whl", "w") as wheel:
            for file in invented.iterdir():
                content = b"something else" if file.name == pip.tamper else file.read_bytes()
                wheel.writestr(f"imagecorruptions/frost/{file.name}", content)
            wheel.writestr("imagecorruptions/__init__.py", "raise SystemExit('imported')")
            wheel.writestr("../outside.txt", "escaped")
        return subprocess.CompletedProcess(command, 0, "", "")

    pip = type("Pip", (), {"calls": calls, "tamper": None})()
    monkeypatch.setattr(frost_assets.subprocess, "run", download)
    return pip


def test_a_named_folder_is_used_and_its_files_are_verified(invented, monkeypatch):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(invented))
    assert frost_assets.read_texture(3) == (invented / "frost4.jpg").read_bytes()
    (invented / "frost2.png").write_bytes(b"snow")
    refusal(lambda: frost_assets.read_texture(1), AssetError, invented / "frost2.png")


def test_a_named_folder_without_the_file_is_an_error_and_nothing_else_is_tried(invented, monkeypatch, tmp_path, pip):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(tmp_path))
    refusal(lambda: frost_assets.read_texture(0), AssetError, tmp_path / "frost1.png")
    assert pip.calls == []


def test_an_installed_package_is_found_but_not_imported(invented, monkeypatch, tmp_path):
    package = tmp_path / "site" / "imagecorruptions"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise SystemExit('imported')")
    invented.rename(package / "frost")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.setattr(frost_assets, "find_spec", __import__("importlib.util").util.find_spec)
    assert frost_assets.read_texture(0) == (package / "frost" / "frost1.png").read_bytes()
    assert "imagecorruptions" not in sys.modules


def test_textures_are_fetched_once_and_again_when_the_cache_is_damaged(invented, pip, capsys, tmp_path):
    first = (invented / "frost1.png").read_bytes()
    assert frost_assets.read_texture(0) == first
    assert capsys.readouterr().err
    frost_assets.read_texture(4)
    assert len(pip.calls) == 1
    assert "--no-deps" in pip.calls[0]
    assert sorted(path.name for path in cache_folder("frost").iterdir()) == sorted(frost_assets.TEXTURES)
    assert not list(tmp_path.rglob("outside.txt"))
    (cache_folder("frost") / "frost1.png").write_bytes(b"half")
    assert frost_assets.read_texture(0) == first
    assert capsys.readouterr().err
    assert len(pip.calls) == 2


def test_wheel_with_a_wrong_texture_is_refused_and_not_cached(invented, pip):
    pip.tamper = "frost3.png"
    refusal(lambda: frost_assets.read_texture(0), AssetError, frost_assets.WHEEL)
    assert list(cache_folder("frost").iterdir()) == []


@pytest.mark.parametrize("places", [{CACHE_VARIABLE: "~no_such_user/cache"}, {}])
def test_frost_without_a_home_folder_is_refused_in_one_sentence(monkeypatch, places):
    for name in ("HOME", "XDG_CACHE_HOME", CACHE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    for name, value in places.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)  # as for a user id without a name in a container
    refusal(lambda: cache_folder("frost"), DataError, places.get(CACHE_VARIABLE, CACHE_VARIABLE))


def test_resizing_equals_cubic_resize_of_opencv():
    image = np.random.default_rng(0).integers(0, 256, (31, 47, 3), dtype=np.uint8)
    for shape in ((31, 47), (90, 52), (35, 140)):
        expected = cv2.resize(image.astype(np.float64), shape[::-1], interpolation=cv2.INTER_CUBIC)
        assert np.abs(resize_cubic(image, shape) - np.clip(expected, 0, 255)).max() < 0.51


@pytest.mark.parametrize("shape", [(16, 16), (41, 30), (30, 200), (150, 100)])
def test_the_frame_is_mixed_with_a_cut_of_the_enlarged_texture(invented, monkeypatch, shape):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(invented))
    frost = Frost()
    frame = np.random.default_rng(5).integers(0, 256, (*shape, 3), dtype=np.uint8)
    for severity in (1, 5):
        state = frost.draw(Rng.of("mix", severity), severity, shape)
        height, width = enlarged_shape(photograph, state.slot, shape)
        assert 0 <= state.top < height - shape[0] + 1
        assert 0 <= state.left < width - shape[1] + 1
        cut = enlarged_texture(photograph, state.slot, shape)[state.top :, state.left :][: shape[0], : shape[1]]
        a, b = frost.parameter(severity)
        expected = np.clip(a * frame + b * cut.astype(np.float64), 0, 255)
        assert np.abs(frost.apply(frame, state, 0) - expected).max() < 0.501


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
            with pytest.raises(AssetError):
                rf.corrupt(grey, grey, load_corruption(name, variant), 2)


def test_frames_of_a_demo_run_made_again_have_the_digest_of_its_rows(no_photographs, tmp_path):
    run = rf.evaluate(ZeroFlow(), "demo", output=tmp_path / "run", corruptions="frost", severities=2)
    plan = recorded_plan(run.manifest.identity, ["frost"], None, {})
    sample = plan.benchmark.dataset.load("motorcycle")
    frames = FrameStage(plan.job(), Seconds(float)).corrupt(sample, "frost", 2)
    (row,) = run.rows.filter(corruption="frost").to_dicts()
    assert frames_digest(frames) == row["frames_digest"]


def test_an_export_of_the_demonstration_holds_the_frames_of_its_run(no_photographs, tmp_path):
    demo = load_benchmark("demo").narrowed(["frost"], [2])
    list(export(demo, tmp_path / "out"))
    sample: Sample = demo.dataset.load("motorcycle")
    frost = load_corruption("frost", classes=DEMO_CLASSES)
    frame = rf.corrupt(*sample.frames, frost, 2, key="motorcycle")[0]
    assert np.array_equal(read_image(tmp_path / "out/frost_2/val/image_2/motorcycle_10.png"), frame)
