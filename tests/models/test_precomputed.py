"""Stored flows are found under the names that other programs give them; names that fit nothing, or two, are refused."""

import numpy as np
import pytest

from robustflow.core.errors import DataError, ModelError
from robustflow.media.flow import write_flow
from robustflow.models import load_model

from ..refusals import refusal

FLOW = np.full((4, 6, 2), 0.5, np.float32)


def stored(folder, *names):
    """Write one flow per name, whose values are its position; return the folder's model."""
    (folder / "clean").mkdir(parents=True, exist_ok=True)
    for place, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_flow(path, FLOW + place)
    return load_model(str(folder))


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("000000", "000000.flo"),
        ("000000", "000000_10.png"),
        ("000000_10", "000000.npy"),
        ("000000", "000000.npy"),
        ("000000", "flow_000000.flo"),
        ("000000", "flow000000.pfm"),
        ("000000", "000000_flow.flo"),
        ("000000", "pred-000000_10.png"),
        ("alley_1/frame_0001", "alley_1/frame0001.flo"),
        ("alley_1/frame_0001", "alley_1/0001.flo"),
        ("alley_1/frame_0001", "alley_1/flow_0001.npy"),
        ("0003/0001", "0003/flow_FW_left_0001.flo5"),
        ("flower_1", "flower_1_flow.flo"),
    ],
)
def test_flow_is_found_under_the_names_of_other_programs(tmp_path, key, name):
    if name.endswith("5"):
        pytest.importorskip("h5py")
    model = stored(tmp_path, f"fog_3/{name}", f"clean/{name}")
    assert model.lookup(key, "fog", 3)[0, 0, 0] == 0.5
    assert model.lookup(key, "clean", 0)[0, 0, 0] == 1.5


def test_flow_of_the_exact_name_takes_precedence(tmp_path):
    model = stored(tmp_path, "clean/flow_a.flo", "clean/a_flow.flo", "clean/a.npy", "clean/a.png")
    assert model.lookup("a", "clean", 0)[0, 0, 0] == 3.5  # .png before .npy


@pytest.mark.parametrize(
    ("names", "key", "named"),
    [
        (["clean/000001_10.png"], "000000", "clean/000001_10.png"),
        (["clean/flow_0.flo"], "000000", "clean/flow_0.flo"),
        (["clean/000000_11.png"], "000000", "clean/000000_11.png"),
        (["clean/flow_BW_left_0001.flo"], "0001", "clean/flow_BW_left_0001.flo"),
        (["clean/flower_1.flo"], "er_1", "clean/flower_1.flo"),
        (["clean/flow_0001.flo"], "bamboo_2/frame_0001", "clean/flow_0001.flo"),
        (["clean/a/0001.flo"], "b/0001", "clean/a"),
        (["clean/flow_1.flo", "clean/1_10.png"], "1", "flow_1.flo"),
        (["other/1.flo"], "1", "other"),
        (["clean/RubberWhale/flow10.flo"], "RubberWhale", "clean/RubberWhale/flow10.flo"),
    ],
)
def test_flow_of_another_name_is_refused_and_what_is_there_named(tmp_path, names, key, named):
    model = stored(tmp_path, *names)
    error = refusal(
        lambda: model.lookup(key, "fog" if "other" in named else "clean", 3 * ("other" in named)), ModelError, tmp_path
    )
    assert named in str(error)


def test_folder_without_clean_flows_is_refused_and_what_is_there_named(tmp_path):
    write_flow(tmp_path / "000000_10.png", FLOW)
    assert "000000_10.png" in str(refusal(lambda: load_model(str(tmp_path)), ModelError, tmp_path))


def test_flows_unpacked_without_their_folders_are_refused(tmp_path):
    write_flow(tmp_path / "clean\\000000.flo", FLOW)
    refusal(lambda: load_model(str(tmp_path)), DataError, tmp_path / "clean\\000000.flo")
