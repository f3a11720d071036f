"""Test frost: texture sources, and blending with a frame."""

import hashlib
import json
import os
import subprocess
import sys
import zipfile

import cv2
import numpy as np
import pytest

from robustflow.core.errors import AssetError, DataError
from robustflow.core.files import CACHE_VARIABLE, cache_folder
from robustflow.core.rng import Rng
from robustflow.corruptions.weather import frost
from robustflow.corruptions.weather import frost_photographs as frost_assets
from robustflow.corruptions.weather.frost import Frost, enlarged_shape, enlarged_texture, photograph, resize_cubic

from ..refusals import refused


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


def wheel_of(folder, path, tamper=None):
    with zipfile.ZipFile(path, "w") as archive:
        for file in folder.iterdir():
            content = b"something else" if file.name == tamper else file.read_bytes()
            archive.writestr(f"imagecorruptions/frost/{file.name}", content)
        archive.writestr("imagecorruptions/__init__.py", "raise SystemExit('imported')")
        archive.writestr("../outside.txt", "escaped")


@pytest.fixture
def pip(monkeypatch, invented):
    """Replaces pip: writes a wheel with fake textures to the download folder."""
    calls = []

    def download(command, **_):
        calls.append(command)
        wheel_of(invented, os.path.join(command[command.index("--dest") + 1], "it.whl"), tamper=pip.tamper)
        return subprocess.CompletedProcess(command, 0, "", "")

    pip = type("Pip", (), {"calls": calls, "tamper": None})()
    monkeypatch.setattr(frost_assets.subprocess, "run", download)
    return pip


def test_a_named_folder_is_used_and_its_files_are_verified(invented, monkeypatch):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(invented))
    assert frost_assets.read_texture(3) == (invented / "frost4.jpg").read_bytes()
    (invented / "frost2.png").write_bytes(b"snow")
    with pytest.raises(AssetError, match="SHA-256"):
        frost_assets.read_texture(1)


def test_a_named_folder_without_the_file_is_an_error_and_nothing_else_is_tried(invented, monkeypatch, tmp_path, pip):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(tmp_path))
    with refused(AssetError, r"frost1\.png not found .*pip install"):
        frost_assets.read_texture(0)
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
    assert "downloading its wheel with pip" in capsys.readouterr().err
    frost_assets.read_texture(4)
    assert len(pip.calls) == 1
    assert "--no-deps" in pip.calls[0]
    assert sorted(path.name for path in cache_folder("frost").iterdir()) == sorted(frost_assets.TEXTURES)
    assert not list(tmp_path.rglob("outside.txt"))
    (cache_folder("frost") / "frost1.png").write_bytes(b"half")
    assert frost_assets.read_texture(0) == first
    assert "SHA-256 differs" in capsys.readouterr().err
    assert len(pip.calls) == 2


def test_wheel_with_a_wrong_texture_is_refused_and_not_cached(invented, pip):
    pip.tamper = "frost3.png"
    with pytest.raises(AssetError, match=r"frost3\.png in the wheel .* wrong SHA-256"):
        frost_assets.read_texture(0)
    assert list(cache_folder("frost").iterdir()) == []


@pytest.mark.parametrize(("offset", "value"), [(8, 1), (10, 8)], ids=["encrypted", "not deflated"])
def test_unreadable_wheel_is_refused_in_one_sentence(invented, tmp_path, offset, value):
    wheel_of(invented, tmp_path / "it.whl")
    data = bytearray((tmp_path / "it.whl").read_bytes())
    data[data.index(b"PK\x01\x02") + offset] = value
    (tmp_path / "it.whl").write_bytes(data)
    with refused(AssetError, "the wheel downloaded by pip .* is not usable"):
        frost_assets._unpack(tmp_path / "it.whl")


@pytest.mark.parametrize("places", [{CACHE_VARIABLE: "~no_such_user/cache"}, {}])
def test_frost_without_a_home_folder_is_refused_in_one_sentence(monkeypatch, places):
    for name in ("HOME", "XDG_CACHE_HOME", CACHE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    for name, value in places.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)  # as for a user id without a name in a container
    with refused(DataError, "there is no such user" if places else f"no home folder.*set {CACHE_VARIABLE}"):
        cache_folder("frost")


def test_failed_download_names_both_remedies_in_one_line(invented, monkeypatch):
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    for name in ("PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS"):
        monkeypatch.delenv(name, raising=False)
    with refused(AssetError, frost_assets.FOLDER_VARIABLE) as caught:
        frost_assets.read_texture(0)
    assert "pip install --no-deps imagecorruptions" in str(caught.value)
    assert list(cache_folder("frost").iterdir()) == []


FETCH_IN_A_PROCESS = """
import json, os, shutil, subprocess, sys
from robustflow.corruptions.weather import frost_photographs as frost_assets
frost_assets.TEXTURES = json.loads(sys.argv[1])
frost_assets.find_spec = lambda name: None
def download(command, **_):
    shutil.copy(sys.argv[2], command[command.index("--dest") + 1])
    return subprocess.CompletedProcess(command, 0, "", "")
frost_assets.subprocess.run = download
for _ in range(20):
    for slot in range(5):
        frost_assets.read_texture(slot)
    frost_assets._fetch(frost_assets.cache_folder("frost"))
"""


def test_two_processes_fetch_the_textures_at_once(invented, tmp_path):
    wheel_of(invented, tmp_path / "it.whl")
    command = [sys.executable, "-c", FETCH_IN_A_PROCESS, json.dumps(frost_assets.TEXTURES), str(tmp_path / "it.whl")]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    for process in processes:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
        assert "SHA-256" not in errors
    assert sorted(path.name for path in cache_folder("frost").iterdir()) == sorted(frost_assets.TEXTURES)


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


def test_all_five_textures_and_many_positions_are_drawn(invented, monkeypatch):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(invented))
    states = [Frost().draw(Rng.of("slots", seed), 3, (20, 20)) for seed in range(100)]
    counts = np.bincount([state.slot for state in states], minlength=5)
    assert counts.min() >= 8
    assert len({(state.top, state.left) for state in states}) > 80


def test_enlarged_textures_are_kept_within_the_bound(invented, monkeypatch):
    monkeypatch.setenv(frost_assets.FOLDER_VARIABLE, str(invented))
    monkeypatch.setattr(frost, "_KEPT_BYTES", 100_000)
    first = enlarged_texture(photograph, 0, (50, 80))
    assert enlarged_texture(photograph, 0, (50, 80)) is first
    for size in range(60, 120, 5):
        enlarged_texture(photograph, 1, (size, size))
        assert sum(image.nbytes for image in frost._enlarged.values()) <= 100_000 or (len(frost._enlarged) == 1)


def test_frost_with_the_real_textures_changes_the_frame():
    clear_caches()
    try:
        pictures = [photograph(slot) for slot in range(5)]
    except AssetError as error:
        pytest.skip(f"frost textures are not available: {error}")
    assert all(picture.ndim == 3 and picture.dtype == np.uint8 for picture in pictures)
    assert np.array_equal(pictures[1], pictures[2])
    frame = np.zeros((64, 96, 3), np.uint8)
    frost = Frost()
    corrupted = frost.apply(frame, frost.draw(Rng.of("real"), 5, (64, 96)), 0)
    assert corrupted.std() > 1
