"""Test PSF blur with the shipped lenses and with stacks from files."""

import io
import pickle
import zipfile

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import AssetError, DataError, RunError
from robustflow.corruptions import blur, corrupt, load_corruption
from robustflow.corruptions.blur import PSF_DIR, PsfBlur, reference_field
from robustflow.corruptions.optics.psf_field import PsfField
from robustflow.data.benchmarks import load_benchmark
from robustflow.run.stages import frames_digest

from ..refusals import refusal

# Stacks from files


@pytest.fixture
def stacks(tmp_path):
    """Return a folder with five `.pth` files, named as in the reference code."""
    torch = pytest.importorskip("torch", reason="requires the extra torch")
    folder = tmp_path / "psf"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for rms in PsfBlur.paper_severities:
        stack = torch.from_numpy(rng.random((64, 3, 61, 61)).astype(np.float32))
        torch.save(stack, folder / f"piece_1_fov20.0_fnum2.0_aper0_rms{rms:.4f}_idx1.pth")
    return folder


@pytest.mark.torch
def test_blurs_are_turned_into_convolution_kernels(stacks, monkeypatch):
    import torch

    corruption = PsfBlur(psf_dir=stacks)
    raw = torch.load(next(stacks.glob("*rms0.1102*")), weights_only=True).numpy()
    expected = PsfField(raw[:, :, ::-1, ::-1])
    assert corruption.field(0.1102).digest == expected.digest
    assert PsfBlur().source == ""
    monkeypatch.setenv(PSF_DIR, str(stacks))
    assert load_corruption("psf_blur").source == corruption.source
    assert corruption.source.startswith("reference ")


@pytest.mark.torch
def test_run_with_changed_psf_stacks_is_refused(stacks, tmp_path, monkeypatch):
    options = {"output": tmp_path / "run", "corruptions": ["contrast"], "severities": [1]}
    rf.evaluate("dis", **options)
    monkeypatch.setenv(PSF_DIR, str(stacks))
    with pytest.raises(RunError):
        rf.evaluate("dis", **options)


def test_missing_psf_folder_or_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    refusal(lambda: PsfBlur(psf_dir="~/nowhere").field(0.0296), AssetError, tmp_path / "nowhere")
    refusal(lambda: PsfBlur(psf_dir="~").field(0.0296), AssetError, tmp_path)
    (tmp_path / "x_rms0.0296.pth").symlink_to(tmp_path / "nowhere")
    refusal(lambda: PsfBlur(psf_dir="~").field(0.0296), DataError, tmp_path / "x_rms0.0296.pth")


@pytest.mark.torch
def test_worker_processes_read_the_named_folder(stacks, tmp_path, monkeypatch):
    monkeypatch.setenv(PSF_DIR, str(stacks))
    options = {"corruptions": ["psf_blur"], "severities": [1, 2], "engine": "processes", "workers": 2}
    run = rf.evaluate("farneback", output=tmp_path / "run", **options)
    frames = load_benchmark("demo").dataset.load("motorcycle").frames
    for severity in (1, 2):
        (row,) = run.rows.filter(corruption="psf_blur", severity=severity).to_dicts()
        assert row["frames_digest"] == frames_digest(corrupt(*frames, "psf_blur", severity, key="motorcycle"))


def test_a_stack_of_an_old_pytorch_is_read(stacks):
    import torch

    path = next(stacks.glob("*rms0.0296*"))
    stack = torch.load(path, weights_only=True)
    before = PsfBlur(psf_dir=stacks).field(0.0296).digest
    torch.save(stack, path, _use_new_zipfile_serialization=False)
    reference_field.cache_clear()
    assert PsfBlur(psf_dir=stacks).field(0.0296).digest == before


class _Hostile:
    def __reduce__(self):
        return print, ("executed",)


@pytest.mark.torch
@pytest.mark.parametrize("kind", ["garbage", "pickle", "shape", "dtype", "dictionary", "nan", "large", "count"])
def test_hostile_and_wrong_files_are_refused(stacks, kind, capsys, monkeypatch):
    import torch

    path = next(stacks.glob("*rms0.0296*"))
    good = torch.ones(64, 3, 61, 61)
    if kind == "garbage":
        path.write_bytes(b"\x80\x02garbage")
    elif kind == "pickle":
        buffer = io.BytesIO()
        torch.save(good, buffer)
        with zipfile.ZipFile(buffer) as source, zipfile.ZipFile(path, "w") as target:
            for entry in source.namelist():
                hostile = entry.endswith("data.pkl")
                target.writestr(entry, pickle.dumps(_Hostile()) if hostile else source.read(entry))
    elif kind == "count":  # the index declares a storage of 4 TB
        torch.save(good[:1, :1, :1, :1].clone(), path)
        with zipfile.ZipFile(path) as source:
            parts = {entry: source.read(entry) for entry in source.namelist()}
        (index,) = (entry for entry in parts if entry.endswith(".pkl"))
        assert b"K\x01t" in parts[index]
        parts[index] = parts[index].replace(b"K\x01t", b"\x8a\x05\x00\x00\x00\x00\x01t")
        with zipfile.ZipFile(path, "w") as target:
            for entry, content in parts.items():
                target.writestr(entry, content)
    elif kind == "large":
        monkeypatch.setattr(blur, "LARGEST", 1000)
    else:
        wrong = {"shape": good[1:], "dtype": good.double(), "dictionary": {"psf": good}, "nan": good * torch.nan}
        torch.save(wrong[kind], path)
    refusal(lambda: PsfBlur(psf_dir=stacks).field(0.0296), DataError, path)
    assert "executed" not in capsys.readouterr().out
