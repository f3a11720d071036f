"""A model runs on RobustSpring's frames, and its flows are written in the server's layout."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from robustflow.analysis.results_file import read_results
from robustflow.api import evaluate
from robustflow.datasets.robustspring_condition import CORRUPTIONS, SEQUENCES, Condition, submitted
from robustflow.errors import DataError, UsageError
from robustflow.flowio import read_flow, write_flow
from robustflow.images.io import read_image
from robustflow.models import load_model
from tests.datasets.layouts import picture

h5py = pytest.importorskip("h5py", reason="needs the extra h5")

_FEW = ("fog", "rain")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "still"
    return evaluate("farneback", "demo", output=folder, corruptions=["contrast"], severities=[1]).path


@pytest.fixture
def frames(tmp_path):
    """Two short sequences from both cameras, clean and under two corruptions, laid out like the unpacked archives."""
    root = tmp_path / "RobustSpring"
    for condition in ("spring", *_FEW):
        for sequence, count in (("0003", 3), ("0028", 2)):
            for side in ("left", "right"):
                for number in range(1, count + 1):
                    place = root / condition / "test" / sequence / f"frame_{side}" / f"frame_{side}_{number:04d}.png"
                    picture(place, 48, 64)
    return root


def test_what_a_whole_submission_consists_of():
    paths = list(submitted())
    assert len(paths) == len(set(paths)) == 21 * 4 * sum(frames - 1 for frames in SEQUENCES.values())
    # the test split has two thousand images, half of them from each camera
    assert sum(SEQUENCES.values()) == 1000
    assert {path.split("/")[0] for path in paths} == {"clean", *CORRUPTIONS}
    assert "zoom_blur/test/0046/flow_BW_right/flow_BW_right_0117.flo5" in paths
    assert "clean/test/0003/flow_FW_left/flow_FW_left_0131.flo5" not in paths
    assert "clean/test/0003/flow_BW_left/flow_BW_left_0001.flo5" not in paths


def test_backwards_is_from_the_later_frame(frames):
    forward, backward = (Condition(frames, "rain", direction) for direction in ("FW", "BW"))
    assert len(forward) == len(backward) == 6
    ahead = forward.load("0003/flow_FW_left/flow_FW_left_0002").frames
    back = backward.load("0003/flow_BW_left/flow_BW_left_0003").frames
    folder = frames / "rain/test/0003/frame_left"
    for pair, numbers in ((ahead, (2, 3)), (back, (3, 2))):
        for frame, number in zip(pair, numbers, strict=True):
            assert np.array_equal(frame, read_image(folder / f"frame_left_{number:04d}.png"))
    assert list(forward.around("0003/flow_FW_left/flow_FW_left_0002", 5)) == [-1, 0, 1]
    assert list(backward.around("0003/flow_BW_left/flow_BW_left_0003", 5)) == [0, 1, 2]


def test_flows_are_the_models_on_those_frames(robustflow, run, frames):
    code, out, error = robustflow(
        "export", run, "--format", "robustspring", "--data", frames, "-c", "fog,rain", "-o", "submission"
    )
    assert code == 0, error
    assert "submission: 36 flows, 36 written and 0 already present" in out
    assert "incomplete submission: " in out
    written = {str(path.relative_to("submission")) for path in Path("submission").rglob("*.flo5")}
    assert len(written) == 36
    assert "fog/test/0028/flow_BW_right/flow_BW_right_0002.flo5" in written
    model = load_model("farneback")
    key = "0003/flow_BW_left/flow_BW_left_0003"
    flows = {}
    for condition, folder in (("clean", "spring"), ("rain", "rain")):
        numbers = (3, 2)
        pair = [
            read_image(frames / folder / "test/0003/frame_left" / f"frame_left_{number:04d}.png") for number in numbers
        ]
        path = Path("submission") / condition / "test" / f"{key}.flo5"
        with h5py.File(path) as file:
            assert file["flow"].compression == "gzip"
            assert file["flow"].compression_opts == 5
            assert file["flow"].dtype == np.float32
        flows[condition] = read_flow(path)[0]
        assert np.array_equal(flows[condition], model.predict(*pair))

    (line,) = read_results("submission/results.csv")
    rcre = line.numbers("rcre")
    assert (line.benchmark, line.setting) == ("robustspring", "knowledge")
    assert set(rcre) == {"robustspring_fog", "robustspring_rain", "average"}
    moved = []
    for path in Path("submission/rain").rglob("*.flo5"):
        clean = read_flow(Path("submission/clean") / path.relative_to("submission/rain"))[0]
        moved.append(np.hypot(*np.moveaxis(read_flow(path)[0].astype(float) - clean, 2, 0)).mean())
    assert rcre["robustspring_rain"] == pytest.approx(np.mean(moved), rel=1e-12)
    assert rcre["average"] == pytest.approx((rcre["robustspring_rain"] + rcre["robustspring_fog"]) / 2)


def test_export_has_the_three_robustness_numbers_of_the_server_and_says_how_it_rounds(robustflow, run, frames):
    """`compute_flow_errors` from cv-stuttgart/springwebsite at bbfabe8, with the clean flow as the baseline. Some flows
    are long or strongly changed, so that Fl, with its two bounds, and 1px differ.
    """
    command = ("export", run, "--format", "robustspring", "--data", frames, "-c", "fog,rain", "-o", "submission")
    assert robustflow(*command)[0] == 0
    rng = np.random.default_rng(0)
    for path in sorted(Path("submission").rglob("*.flo5")):
        spread = 60.0 if "clean" in path.parts else 0.0
        clean = read_flow(Path("submission/clean", *path.parts[2:]))[0]
        write_flow(path, (clean + rng.normal(0, spread or 3.0, clean.shape)).astype(np.float32))
    code, out, error = robustflow(*command)
    assert code == 0, error
    expected = {}
    for condition in _FEW:
        names = [
            path.relative_to(f"submission/{condition}") for path in Path(f"submission/{condition}").rglob("*.flo5")
        ]
        baseline, corrupted = (
            np.stack([read_flow(Path("submission") / each / name)[0].astype(float) for name in names])
            for each in ("clean", condition)
        )
        epe = np.linalg.norm(baseline - corrupted, axis=-1)
        fl = (epe > 3) & (epe > 0.05 * np.linalg.norm(baseline, axis=-1))
        assert 0 < fl.mean() < (epe > 3).mean() < (epe > 1).mean() < 1
        expected[f"robustspring_{condition}"] = [np.mean(epe), 100 * np.mean(fl), 100 * np.mean(epe > 1)]
    expected["average"] = np.mean(list(expected.values()), axis=0)
    head, *lines = Path("submission/robustness.csv").read_text().splitlines()
    assert head == "corruption,pairs,epe,fl,px1"
    found = {line.split(",")[0]: line.split(",")[1:] for line in lines}
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name][0] == "12"
        assert [float(cell) for cell in found[name][1:]] == pytest.approx(values, rel=1e-9)
    epe, fl, px1 = expected["average"]
    assert f"the flow changed by {epe:.2f} px on average (EPE robustness), Fl {fl:.2f} %, 1px {px1:.2f} %" in out
    assert "the server evaluates about 0.1 % of the pixels, subsampled in float16" in out


def test_exports_are_one_sample_set_only_over_the_same_corruptions_of_the_same_frames(robustflow, run, frames):
    sets = {}
    for corruption, pairs in (("fog", 4), ("rain", 4), ("fog", 2)):
        out = f"{corruption} {pairs}"
        command = ("export", run, "--format", "robustspring", "--data", frames, "-c", corruption, "--limit", pairs)
        assert robustflow(*command, "-o", out)[0] == 0
        (sets[out],) = (line.frames for line in read_results(f"{out}/results.csv"))
    assert len(set(sets.values())) == 3
    again = ("export", run, "--format", "robustspring", "--data", frames, "-c", "fog", "--limit", 4, "-o", "again")
    assert robustflow(*again)[0] == 0
    assert [line.frames for line in read_results("again/results.csv")] == [sets["fog 4"]]


def test_a_stopped_export_continues_and_has_the_same_results(robustflow, run, frames):
    command = ("export", run, "--format", "robustspring", "--data", frames, "-c", "fog", "--limit", "4", "-o", "out")
    assert "8 flows, 8 written" in robustflow(*command)[1]
    first = Path("out/results.csv").read_bytes()
    gone = sorted(Path("out/fog").rglob("*.flo5"))[1]
    gone.unlink()
    assert "8 flows, 1 written and 7 already present" in robustflow(*command)[1]
    assert Path("out/results.csv").read_bytes() == first


def test_another_model_than_the_runs_is_refused(robustflow, run, frames):
    command = ("export", run, "--format", "robustspring", "--data", frames, "--limit", "1", "-c", "fog")
    code, _, error = robustflow(*command, "--model", "dis")
    assert code == 1
    assert "not the model of" in error
    code, _, error = robustflow(*command, "-O", "winsize=5")
    assert code == 1
    assert "differs in" in error
    assert not Path("submission").exists()


def test_frames_that_are_not_there(robustflow, run, frames):
    export = ("export", run, "--format", "robustspring")
    code, _, error = robustflow(*export)
    assert code == 2
    assert "give --data" in error
    code, _, error = robustflow(*export, "--data", frames)
    assert code == 1
    assert "brightness/test" in error
    code, _, error = robustflow(*export, "--data", frames, "-c", "motion")
    assert code == 2
    assert "'motion' does not exist" in error
    (frames / "fog/test/0028/frame_left/frame_left_0002.png").unlink()
    code, _, error = robustflow(*export, "--data", frames, "-c", "fog")
    assert code == 1
    assert "fog lacks the pair 0028/flow_FW_left/flow_FW_left_0001" in error
    shutil.rmtree(frames / "spring/test/0003/frame_right")
    with pytest.raises(DataError, match="both cameras"):
        Condition(frames)
    with pytest.raises(UsageError, match="direction 'up'"):
        Condition(frames, direction="up")
