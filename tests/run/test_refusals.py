"""What cannot be measured is refused by the name of its option, before anything is computed or written."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError, as_argument
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.benchmarks.export import export
from robustflow.media.flow import write_flow
from robustflow.models import load_model
from robustflow.testing import ZeroClipFlow, ZeroFlow

from ..refusals import refusal
from .conftest import SMALLEST

CLIPS = "tests.run.models_for_tests:FiveFrames"
FLOWS = "flows"
"""A folder with the flow of a pair."""
HAZE = "tests.run.test_depth:Haze"
REFUSED = [
    ("dis", {"batch_size": 2}, "--batch-size"),
    ("dis", {"batch_size": 0}, "--batch-size"),
    (CLIPS, {"batch_size": 2}, "--batch-size"),
    (ZeroClipFlow("all"), {}, "window"),
    ("dis", {"confidence": "model"}, "--confidence"),
    ("dis", {"confidence": "forward"}, "forward"),
    ("dis", {"draws": 2, "confidence": "forward-backward"}, "--confidence"),
    (FLOWS, {"confidence": "forward-backward"}, ""),
    (FLOWS, {"still": True}, "--still"),
    *(("dis", {"benchmark": name, "data": "nowhere", "still": True}, "--still") for name in ("kitti-fc", "gopro-fc")),
    *(("dis", {"name": name}, repr(name.strip())) for name in ("", "  ", "x" * 81, "two\nlines")),
    *(("dis", {name: value}, name) for name, value in (("seed", "1"), ("draws", 0), ("allow_invalid", "no"))),
    (CLIPS, {"corruptions": "fog_3d", "data_options": {"depth": "maps"}}, "--model"),
    ("dis", {"corruptions": "fog", "data_options": {"depth": "maps"}}, "--depth"),
    ("dis", {"corruptions": "fog_3d", "data_options": {"depth": "nowhere"}}, "--depth"),
    ("dis", {"corruptions": "fog_3d", "data_options": {"focal": 50}}, "--focal"),
    ("dis", {"corruptions": "fog_3d", "data_options": {"depth_unit": "mm"}}, "--depth-unit"),
]


@pytest.fixture
def files(clip_folder, tmp_path, monkeypatch):
    """A working folder with depth maps and with flows."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / FLOWS / "clean").mkdir(parents=True)
    write_flow(tmp_path / FLOWS / "clean" / "0.flo", np.zeros((48, 64, 2), np.float32))
    (tmp_path / "maps").mkdir()
    for number in range(6):
        np.save(tmp_path / "maps" / f"{number}.npy", np.full((48, 64), 10, np.float32))


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(("model", "options", "culprit"), REFUSED)
def test_request_is_refused_by_name_and_nothing_is_written(clip_folder, tmp_path, model, options, culprit):
    given = {"benchmark": "folder", "data": clip_folder, "output": tmp_path / "run", **SMALLEST, **options}
    with pytest.raises((UsageError, ModelError)) as refused:
        rf.evaluate(model, **given)
    assert refused.value.culprit == as_argument(culprit) or not culprit
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("name", "culprit"),
    [("fog_3d", "fog_3d"), ("fog+fog_3d:2", "fog+fog_3d:2"), (HAZE, "haze"), (f"fog+{HAZE}:2", "fog+haze:2")],
)
def test_corruption_in_depth_is_refused_for_data_without_depth(clip_folder, tmp_path, name, culprit):
    run = {"data": clip_folder, "output": tmp_path / "run", "corruptions": [name], "severities": [1]}
    refusal(lambda: rf.evaluate("dis", "folder", **run), UsageError, culprit)
    benchmark = load_benchmark("folder", clip_folder).narrowed([name], [1])
    refusal(lambda: list(export(benchmark, tmp_path / "frames")), UsageError, culprit)
    assert not list(tmp_path.iterdir())


def test_tiles_of_a_multi_frame_model_are_refused():
    with pytest.raises(UsageError):
        load_model(CLIPS, tile="64x64")


NUMBERS = {name: name for name in ("workers", "batch_size", "timeout", "limit", "draws")}


@pytest.mark.parametrize("option", [*NUMBERS, "seed", "severities"])
@pytest.mark.parametrize("value", ["2", 0.5, True, -1, [2, "3"], float("nan")])
def test_argument_that_is_not_a_usable_number_is_refused(tmp_path, option, value):
    if (option, value) in (("timeout", 0.5), ("seed", -1)):
        pytest.skip("this value is valid")
    with pytest.raises(UsageError) as refused:
        rf.evaluate(ZeroFlow(), "demo", output=tmp_path, **{"corruptions": "contrast", option: value})
    assert NUMBERS.get(option, "") in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["batch_size", "limit"])
def test_whole_number_of_numpy_is_accepted(tmp_path, option):
    assert rf.evaluate(ZeroFlow(), "demo", output=tmp_path, **SMALLEST, **{option: np.int64(1)}).rcre == 0
