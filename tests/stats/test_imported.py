"""Result files of the reference code are read, and invalid ones are rejected."""

import json
import math
import os
import threading
from contextlib import suppress
from statistics import fmean

import pytest

from robustflow.core.errors import DataError
from robustflow.corruptions import IMAGE_PAIR
from robustflow.stats.frame import DERIVED
from robustflow.stats.imported import NOTE, read_imported
from robustflow.stats.lines import lines_of
from robustflow.stats.results_file import parse_results, read_results, results_csv
from tests.refusals import refusal

_ON_DISK = ["brightness" if name == "high_light" else name for name in IMAGE_PAIR]


def _reference(names=_ON_DISK, **changed):
    """Write a file as benchmark.py does: NumPy's mean of [[]] is NaN, and json.dump writes NaN."""
    content = {"clean": {"CRE": [[]], "rCRE": [[]], "clean_EPE": [3.5], "corrupt_EPE": [[]], "CRE_mean": math.nan}}
    for number, name in enumerate(names):
        cre = [(number + 1) * severity / 10 for severity in range(1, 6)]
        content[name] = {
            "CRE": cre,
            "rCRE": [value + 1 for value in cre],
            "clean_EPE": [3.5] * 5,
            "corrupt_EPE": [value + 3.5 for value in cre],
            "CRE_mean": fmean(cre),
            "result": "words",
        }
    return content | changed


def _write(folder, content, name="results.json"):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content, indent=4))
    return path


def test_results_file_of_the_reference_code_is_read(tmp_path):
    read = read_imported([_write(tmp_path / "RAFT_ood_2024-11-01_10-00-00", _reference())])
    ((key, line),) = lines_of(read).items()
    assert (key.setting, key.model) == ("UNKNOWN", "RAFT_ood_2024-11-01_10-00-00")
    assert (key.benchmark, line.fact("note")) == ("kitti-fc", NOTE)
    assert key.sample_set == "Reference code, kitti-fc, average over 20 corruptions"
    cre, epe, rcre = (
        {of: row["value"] for (name, of, _), row in line.items() if name == metric and row["origin"] != DERIVED}
        for metric in ("cre", "epe", "rcre")
    )
    assert cre["high_light"] == pytest.approx(0.3 * 5)
    assert cre["average"] == pytest.approx(fmean(0.3 * (number + 1) for number in range(20)))
    assert epe["clean"] == 3.5
    assert epe["average"] == pytest.approx(3.5 + cre["average"])
    assert rcre["average"] == pytest.approx(1 + cre["average"])
    assert "clean" not in cre


def test_gopro_results_have_only_rcre_and_averages_name_their_corruptions(tmp_path):
    few = {name: {"rCRE": [1, 2, 3, 4, 5], "rCRE_mean": 3.0} for name in ("h264_abr", "h264_crf", "bit_error")}
    ((key, line),) = lines_of(read_imported([_write(tmp_path / "RAFT", few)])).items()
    assert (key.benchmark, {metric for metric, *_ in line}) == ("gopro-fc", {"rcre"})
    assert key.sample_set.endswith("average over 3 corruptions: h264_crf, h264_abr, bit_error")
    (without,) = lines_of(read_imported([_write(tmp_path / "GMA", _reference(_ON_DISK[:-1]))]))
    assert without.sample_set.endswith("average over 19 corruptions, without psf_blur")


def test_files_with_equal_corruptions_form_one_group(tmp_path):
    paths = [_write(tmp_path / name, _reference()) for name in ("RAFT_ood", "GMA_ood")]
    lines = lines_of(read_imported(paths))
    assert [line.model for line in lines] == ["RAFT_ood", "GMA_ood"]
    assert len({line.sample_set for line in lines}) == 1


def test_imported_results_survive_a_round_trip_through_csv(tmp_path):
    frame = read_imported([_write(tmp_path / "a", _reference())])
    again = parse_results(results_csv(frame), "results.csv", "file")
    assert again.drop("decimals").equals(frame.drop("decimals"))


@pytest.mark.parametrize(
    ("content", "where"),
    [
        ("", ""),
        ("[" * 100_000, ""),
        ('{"fog": {}, "fog": {}}', ""),
        ("9" * 10_000, ""),
        ([1], ""),
        ({"version": 1, "runs": []}, ""),
        (_reference(["foog"]), ""),
        (_reference(["fog\x1b[31m"]), ""),
        (_reference(fog={"rCRE": [1, 2, 3]}), ", 'fog', rCRE"),
        (_reference(fog={"rCRE": 3}), ", 'fog', rCRE"),
        (_reference(fog={"rCRE": [1, 2, 3, 4, math.nan]}), ", 'fog', rCRE"),
        (_reference(fog={"rCRE": [1, 2, 3, 4, 10**400]}), ", 'fog', rCRE"),
        (_reference(fog={"rCRE": [1, 2, 3, 4, -1]}), ", 'fog', rCRE"),
        (_reference(fog={"rCRE": [1, 2, 3, 4, "5"]}), ", 'fog', rCRE"),
        (_reference(fog={"rCRE": [1, 2, 3, 4, True]}), ", 'fog', rCRE"),
        (_reference(clean={"clean_EPE": [math.nan]}), ", 'clean', clean_EPE"),
        ({"clean": {"clean_EPE": [3.5], "rCRE": [[]]}}, ""),
    ],
)
def test_wrong_results_file_is_refused_with_the_place(tmp_path, content, where):
    path = _write(tmp_path, content)
    error = refusal(lambda: read_imported([path]), DataError, f"{path}{where}")
    assert "\x1b" not in str(error)


def test_missing_or_too_large_file_is_refused(tmp_path):
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(17 * 2**20)
    for path in (tmp_path / "results.json", large, tmp_path):
        with pytest.raises(DataError) as caught:
            read_imported([path])
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("read", [lambda path: read_imported([path]), read_results])
def test_results_from_an_endless_pipe_are_refused_at_their_maximum_size(tmp_path, read):
    path = tmp_path / "pipe"
    os.mkfifo(path)

    def write_until_closed():
        with suppress(BrokenPipeError), path.open("wb") as file:
            for _ in range(80):
                file.write(bytes(2**20))

    threading.Thread(target=write_until_closed, daemon=True).start()
    refusal(lambda: read(path), DataError, path)
