"""A model runs on RobustSpring's frames, and its flows are written in the server's layout."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets.robustspring import CORRUPTIONS, SEQUENCES, ConditionPairs, submitted
from robustflow.media.flow import read_flow, write_flow
from robustflow.media.images import read_image
from robustflow.models import load_model
from robustflow.stats.lines import lines_of
from robustflow.stats.results_file import read_results
from tests.data.datasets import layouts

h5py = pytest.importorskip("h5py", reason="needs the extra h5")

_FEW = ("fog", "rain")


@pytest.fixture
def frames(tmp_path):
    return layouts.robustspring(tmp_path / "RobustSpring")


@pytest.fixture
def export(runs, frames, monkeypatch):
    """The command that exports a run of Farneback's method on these frames, as if they were the whole test split."""
    monkeypatch.setattr("robustflow.data.datasets.robustspring.SEQUENCES", {3: 3, 28: 2})
    return ("export", runs[1], "--format", "robustspring", "--data", frames)


def test_whole_submission_has_a_file_for_every_pair_camera_and_direction():
    paths = list(submitted())
    assert len(paths) == len(set(paths)) == 21 * 4 * sum(frames - 1 for frames in SEQUENCES.values())
    # the test split has two thousand images, half of them from each camera
    assert sum(SEQUENCES.values()) == 1000
    assert {path.split("/")[0] for path in paths} == {"clean", *CORRUPTIONS}
    assert "zoom_blur/test/0046/flow_BW_right/flow_BW_right_0117.flo5" in paths
    assert "clean/test/0003/flow_FW_left/flow_FW_left_0131.flo5" not in paths
    assert "clean/test/0003/flow_BW_left/flow_BW_left_0001.flo5" not in paths


def test_backward_flow_is_from_the_later_frame(frames):
    pairs = ConditionPairs(frames, "rain")
    assert len(pairs) == 2 * 6
    ahead = pairs.load("0003/flow_FW_left/flow_FW_left_0002").frames
    back = pairs.load("0003/flow_BW_left/flow_BW_left_0003").frames
    folder = frames / "rain/test/0003/frame_left"
    for pair, numbers in ((ahead, (2, 3)), (back, (3, 2))):
        for frame, number in zip(pair, numbers, strict=True):
            assert np.array_equal(frame, read_image(folder / f"frame_left_{number:04d}.png"))
    assert list(pairs.around("0003/flow_FW_left/flow_FW_left_0002", 5)) == [-1, 0, 1]
    assert list(pairs.around("0003/flow_BW_left/flow_BW_left_0003", 5)) == [0, 1, 2]


def test_exported_flows_equal_the_predictions_of_the_model(robustflow, export, frames):
    out = robustflow.prints(*export, "-c", "fog,rain", "-o", "submission")
    assert "submission: 36 flows, 36 written and 0 already present" in out
    assert f"incomplete submission: {21 * 12 - 36} of {21 * 12} flows are missing" in out
    written = {str(path.relative_to("submission")) for path in Path("submission").rglob("*.flo5")}
    assert len(written) == 36
    assert "fog/test/0028/flow_BW_right/flow_BW_right_0002.flo5" in written
    model = load_model("farneback")
    key = "0003/flow_BW_left/flow_BW_left_0003"
    for condition, folder in (("clean", "spring"), ("rain", "rain")):
        images = [frames / folder / f"test/0003/frame_left/frame_left_000{number}.png" for number in (3, 2)]
        path = Path(f"submission/{condition}/test/{key}.flo5")
        with h5py.File(path) as file:
            flow = file["flow"]
            assert (flow.compression, flow.compression_opts, flow.dtype) == ("gzip", 5, np.float32)
        assert np.array_equal(read_flow(path)[0], model.predict(*map(read_image, images)))

    ((key, line),) = lines_of(read_results("submission/results.csv")).items()
    rcre = line.by_corruption("rcre") | {"average": line.number("rcre", "average")}
    assert (key.benchmark, key.setting) == ("robustspring", "knowledge")
    assert set(rcre) == {"robustspring_fog", "robustspring_rain", "average"}
    moved = []
    for path in Path("submission/rain").rglob("*.flo5"):
        clean = read_flow(Path("submission/clean") / path.relative_to("submission/rain"))[0]
        moved.append(np.hypot(*np.moveaxis(read_flow(path)[0].astype(float) - clean, 2, 0)).mean())
    assert rcre["robustspring_rain"] == pytest.approx(np.mean(moved), rel=1e-12)
    assert rcre["average"] == pytest.approx((rcre["robustspring_rain"] + rcre["robustspring_fog"]) / 2)


def test_export_has_the_three_robustness_numbers_of_the_server_and_says_how_it_rounds(robustflow, export):
    """`compute_flow_errors` from cv-stuttgart/springwebsite at bbfabe8, with the clean flow as the baseline. Some flows
    are long or strongly changed, so that Fl, with its two bounds, and 1px differ.
    """
    command = (*export, "-c", "fog,rain", "-o", "submission")
    robustflow.prints(*command)
    rng = np.random.default_rng(0)
    for path in sorted(Path("submission").rglob("*.flo5")):
        spread = 60.0 if "clean" in path.parts else 3.0
        clean = read_flow(Path("submission/clean", *path.parts[2:]))[0]
        write_flow(path, (clean + rng.normal(0, spread, clean.shape)).astype(np.float32))
    out = robustflow.prints(*command)
    expected = {}
    for condition in _FEW:
        paths = list(Path(f"submission/{condition}").rglob("*.flo5"))
        corrupted = np.stack([read_flow(path)[0].astype(float) for path in paths])
        baseline = np.stack([read_flow(Path("submission/clean", *path.parts[2:]))[0].astype(float) for path in paths])
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
    assert f"{epe:.2f} px on average (EPE robustness), Fl {fl:.2f} %, 1px {px1:.2f} %" in out


def test_exports_are_one_sample_set_only_over_the_same_corruptions_of_the_same_frames(robustflow, export):
    sets = []
    for number, (corruption, pairs) in enumerate([("fog", 4), ("rain", 4), ("fog", 2), ("fog", 4)]):
        robustflow.prints(*export, "-c", corruption, "--limit", pairs, "-o", number)
        sets += read_results(f"{number}/results.csv")["sample_set"].unique().to_list()
    assert len(set(sets)) == 3
    assert sets[0] == sets[3]


def test_a_stopped_export_continues_and_has_the_same_results(robustflow, export):
    command = (*export, "-c", "fog", "--limit", "4", "-o", "out")
    assert "8 flows, 8 written" in robustflow.prints(*command)
    first = Path("out/results.csv").read_bytes()
    sorted(Path("out/fog").rglob("*.flo5"))[1].unlink()
    assert "8 flows, 1 written and 7 already present" in robustflow.prints(*command)
    assert Path("out/results.csv").read_bytes() == first


def test_flows_of_one_model_are_not_reused_for_another(robustflow, export, runs):
    where = ("-c", "fog", "--limit", "2", "-o", "out")
    robustflow.prints(*export, *where)
    before = {path: path.read_bytes() for path in Path("out").rglob("*.flo5")}
    robustflow.refuses("export", runs[0], *export[2:], *where)
    Path("out/model.json").unlink()
    robustflow.refuses(*export, *where)
    assert {path: path.read_bytes() for path in Path("out").rglob("*.flo5")} == before


def test_export_with_a_model_other_than_the_runs_is_refused(robustflow, export):
    command = (*export, "--limit", "1", "-c", "fog")
    robustflow.refuses(*command, "--model", "dis", code=1)
    robustflow.refuses(*command, "-O", "winsize=5", code=1)
    assert not Path("submission").exists()


def test_export_without_its_frames_is_refused(robustflow, export, frames):
    robustflow.refuses(*export, code=1)
    robustflow.refuses(*export, "-c", "motion")
    (frames / "fog/test/0028/frame_left/frame_left_0002.png").unlink()
    assert "0028/flow_BW_left/flow_BW_left_0002" in robustflow.refuses(*export, "-c", "fog", code=1)
    shutil.rmtree(frames / "spring/test/0003/frame_right")
    with pytest.raises(DataError):
        ConditionPairs(frames)
    with pytest.raises(UsageError):
        ConditionPairs(frames, "motion")
