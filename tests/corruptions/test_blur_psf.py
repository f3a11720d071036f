"""Test PSF blur with the shipped lenses and stacks from files, and compare it with the reference implementation."""

import io
import json
import pickle
import zipfile

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.corruptions import corrupt, load_corruption
from robustflow.corruptions.blur import reference_stack
from robustflow.corruptions.blur.psf_blur import PSF_DIR, PsfBlur
from robustflow.errors import AssetError, DataError, RunError, UsageError
from robustflow.images.io import read_image
from robustflow.psf.psf_field import PsfField
from robustflow.psf.shipped import shipped_field

SEVERITIES = (1, 2, 3, 4, 5)


def picture(height=90, width=140, seed=0):
    rng = np.random.default_rng(seed)
    return cv2.GaussianBlur(rng.integers(0, 256, (height, width, 3)).astype(np.uint8), (0, 0), 2.0)


def test_severities_are_the_papers_rms_radii():
    assert PsfBlur().severities == (0.0296, 0.0832, 0.1102, 0.1588, 0.1939)


def test_a_severity_without_a_lens_is_refused():
    with pytest.raises(UsageError, match=r"no lens with an RMS radius of 0\.5"):
        PsfBlur(severities=(0.0296, 0.0832, 0.1102, 0.1588, 0.5))


@pytest.mark.parametrize("severity", SEVERITIES)
def test_each_severity_takes_its_lens(severity):
    blur = PsfBlur()
    assert blur.field(blur.parameter(severity)).digest == shipped_field(severity).digest


@pytest.mark.parametrize(
    ("shape", "greys"), [((16, 16), (0, 1, 127, 254, 255)), ((17, 23), (1, 254)), ((375, 1242), (254,))]
)
def test_flat_stays_flat_everywhere(shape, greys):
    for grey in greys:
        frame = np.full((*shape, 3), grey, np.uint8)
        for variant in ("default", "reference"):
            first, second = corrupt(frame, frame, "psf_blur", 5, variant=variant)
            assert (first == grey).all()
            assert (second == grey).all()


def test_frames_are_blurred_alike_and_seeds_change_nothing():
    frame = picture()
    first, second = corrupt(frame, frame, "psf_blur", 3, seed=1)
    other, _ = corrupt(frame, picture(seed=4), "psf_blur", 3, seed=2, key="another")
    assert (first == second).all()
    assert (first == other).all()


def test_the_reference_variant_cuts_fractions_off():
    frame = picture()
    rounded, _ = corrupt(frame, frame, "psf_blur", 2)
    cut, _ = corrupt(frame, frame, "psf_blur", 2, variant="reference")
    difference = rounded.astype(int) - cut
    assert set(np.unique(difference)) == {0, 1}


def test_means_of_the_channels_stay():
    frame = picture(240, 320)
    for severity in SEVERITIES:
        blurred, _ = corrupt(frame, frame, "psf_blur", severity)
        assert blurred.mean((0, 1)) == pytest.approx(frame.mean((0, 1)), abs=0.6)


# Stacks from files


@pytest.fixture
def stacks(tmp_path, monkeypatch):
    """Return a folder with five `.pth` files, named as in the reference code; the cache is empty."""
    torch = pytest.importorskip("torch", reason="requires the extra torch")
    monkeypatch.setenv("ROBUSTFLOW_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "psf"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for rms in PsfBlur.paper_severities:
        stack = torch.from_numpy(rng.random((64, 3, 61, 61)).astype(np.float32))
        torch.save(stack, folder / f"piece_1_fov20.0_fnum2.0_aper0_rms{rms:.4f}_idx1.pth")
    return folder


@pytest.mark.torch
def test_reference_stacks_are_turned_into_convolution_kernels(stacks):
    import torch

    blur = PsfBlur(psf_dir=stacks)
    raw = torch.load(next(stacks.glob("*rms0.1102*")), weights_only=True).numpy()
    expected = PsfField(raw[:, :, ::-1, ::-1])
    assert blur.field(0.1102).digest == expected.digest
    assert blur.source.startswith("reference ")
    assert PsfBlur().source == ""


@pytest.mark.torch
def test_a_stack_is_converted_once_and_then_needs_no_torch(stacks, monkeypatch):
    first = reference_stack.reference_field(stacks, 0.0832)

    def refuse(*_):
        raise AssertionError("read again")

    monkeypatch.setattr(reference_stack, "_read_tensor", refuse)
    assert reference_stack.reference_field(stacks, 0.0832).digest == first.digest


@pytest.mark.torch
def test_a_damaged_cache_entry_is_made_again(stacks, tmp_path):
    first = reference_stack.reference_field(stacks, 0.0832)
    for kept in (tmp_path / "cache" / "psf").iterdir():
        kept.write_bytes(b"not an array")
    assert reference_stack.reference_field(stacks, 0.0832).digest == first.digest


@pytest.mark.torch
def test_every_flipped_bit_of_a_kept_stack_is_noticed(stacks, tmp_path):
    reference_stack.reference_field(stacks, 0.0832)
    (kept,) = (tmp_path / "cache" / "psf").iterdir()
    whole, rng = kept.read_bytes(), np.random.default_rng(1)
    assert reference_stack._read_kept(kept, kept.stem) is not None
    for place, bit in zip(rng.integers(0, len(whole), 200), rng.integers(0, 8, 200), strict=True):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << bit
        kept.write_bytes(flipped)
        assert reference_stack._read_kept(kept, kept.stem) is None


@pytest.mark.torch
def test_the_environment_names_the_folder(stacks, monkeypatch):
    monkeypatch.setenv(PSF_DIR, str(stacks))
    assert load_corruption("psf_blur").source.startswith("reference ")


@pytest.mark.torch
def test_other_stacks_are_another_run(stacks, tmp_path, monkeypatch):
    options = {"output": tmp_path / "run", "corruptions": ["contrast"], "severities": [1]}
    rf.evaluate("dis", **options)
    monkeypatch.setenv(PSF_DIR, str(stacks))
    with pytest.raises(RunError, match="differs in: psf"):
        rf.evaluate("dis", **options)


def test_a_missing_folder_or_file_is_one_line_that_says_what_to_give(tmp_path):
    with pytest.raises(AssetError, match="does not exist"):
        PsfBlur(psf_dir=tmp_path / "nowhere").field(0.0296)
    with pytest.raises(AssetError, match=r"0 files named \*rms0.0296\*"):
        PsfBlur(psf_dir=tmp_path).field(0.0296)


@pytest.mark.torch
def test_worker_processes_read_the_named_folder(stacks, tmp_path, monkeypatch):
    cells = {"corruptions": ["psf_blur", "contrast"], "severities": [1, 2]}
    monkeypatch.setenv(PSF_DIR, str(stacks))
    run = rf.evaluate("farneback", output=tmp_path / "run", engine="processes", workers=2, **cells)
    alone = rf.evaluate("farneback", output=tmp_path / "alone", engine="serial", **cells)
    assert run.rows.equals(alone.rows)


def test_a_stack_of_an_old_pytorch_is_read(stacks):
    import torch

    path = next(stacks.glob("*rms0.0296*"))
    stack = torch.load(path, weights_only=True)
    before = PsfBlur(psf_dir=stacks).field(0.0296).digest
    torch.save(stack, path, _use_new_zipfile_serialization=False)
    assert reference_stack.reference_field(stacks, 0.0296).digest == before


class _Hostile:
    def __reduce__(self):
        return print, ("executed",)


@pytest.mark.torch
@pytest.mark.parametrize("kind", ["garbage", "pickle", "shape", "dtype", "dictionary", "nan", "large", "bomb", "count"])
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
    elif kind == "bomb":  # a file of 64 kB that expands to 64 MB of zeros
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("archive/data/1", bytes(64 << 20))
        assert path.stat().st_size < reference_stack.LARGEST
    elif kind == "count":  # the index declares a storage of 4 TB
        torch.save(good[:1, :1, :1, :1].clone(), path)
        with zipfile.ZipFile(path) as source:
            parts = {entry: source.read(entry) for entry in source.namelist()}
        with zipfile.ZipFile(path, "w") as target:
            for entry, content in parts.items():
                huge = (
                    content.replace(b"K\x01t", b"\x8a\x05\x00\x00\x00\x00\x01t") if entry.endswith(".pkl") else content
                )
                assert not entry.endswith(".pkl") or huge != content
                target.writestr(entry, huge)
    elif kind == "large":
        monkeypatch.setattr(reference_stack, "LARGEST", 1000)
    else:
        wrong = {"shape": good[1:], "dtype": good.double(), "dictionary": {"psf": good}, "nan": good * torch.nan}
        torch.save(wrong[kind], path)
    with pytest.raises(DataError) as caught:
        PsfBlur(psf_dir=stacks).field(0.0296)
    assert "\n" not in str(caught.value)
    assert "executed" not in capsys.readouterr().out


# Comparison with the reference implementation on its test pair


@pytest.fixture
def reference(shared):
    """Return statistics of the reference implementation (with its defects fixed) and the clean pair."""
    folder = shared("corruption-reference")
    statistics = json.loads((folder / "reference.json").read_text())["psf_blur_repaired"]
    return statistics, [read_image(folder / f"clean_{number}.png") for number in (1, 2)]


def psnr(a, b):
    return 10 * np.log10(255**2 / ((a.astype(float) - b) ** 2).mean())


@pytest.mark.fidelity
@pytest.mark.parametrize("severity", SEVERITIES)
def test_dis_and_farneback_suffer_as_from_the_reference(reference, shared, severity):
    """The CRE of DIS is within 15 % of the reference, and the CRE of Farneback is within 20 %."""
    statistics, frames = reference
    coded = cv2.imread(str(shared("corruption-reference", "flow_occ.png")), cv2.IMREAD_UNCHANGED)[..., ::-1]
    truth, valid = (coded[..., :2].astype(float) - 32768) / 64, coded[..., 2] > 0
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    estimators = {
        "dis": lambda a, b: dis.calc(a, b, None),
        "farneback": lambda a, b: cv2.calcOpticalFlowFarneback(a, b, None, 0.5, 3, 15, 3, 5, 1.2, 0),
    }
    errors = {}
    for label, pair in (("clean", frames), ("blurred", corrupt(*frames, "psf_blur", severity))):
        greys = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in pair]
        for name, estimate in estimators.items():
            errors[name, label] = np.linalg.norm(estimate(*greys) - truth, axis=2)[valid].mean()
    wanted = statistics[f"s{severity}"]
    cre = {name: errors[name, "blurred"] - errors[name, "clean"] for name in estimators}
    assert cre["dis"] == pytest.approx(wanted["cre_dis"], rel=0.15)
    assert cre["farneback"] == pytest.approx(wanted["cre_farneback"], rel=0.2)


@pytest.mark.fidelity
@pytest.mark.parametrize("severity", SEVERITIES)
def test_strength_is_that_of_the_reference(reference, severity):
    """With the shipped lenses, PSNR is within 1 dB of the reference, gradient loss within 30 % and channel means within
    0.6 grey levels.
    """
    statistics, frames = reference
    wanted = statistics[f"s{severity}"]
    for number, (frame, blurred) in enumerate(zip(frames, corrupt(*frames, "psf_blur", severity), strict=True), 1):
        assert psnr(blurred, frame) == pytest.approx(wanted[f"psnr_{number}"], abs=1.0)
        grey = cv2.cvtColor(blurred, cv2.COLOR_RGB2GRAY).astype(float)
        dx, dy = np.diff(grey, axis=1)[:-1], np.diff(grey, axis=0)[:, :-1]
        assert np.sqrt(dx**2 + dy**2).mean() == pytest.approx(wanted[f"grad_{number}"], rel=0.3)
        for channel, name in enumerate("rgb"):
            # the reference truncates, which reduces the mean by half a level; rounding does not
            assert blurred[..., channel].mean() == pytest.approx(wanted[f"mean_{name}_{number}"] + 0.5, abs=0.6)
