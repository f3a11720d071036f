"""Splits do not depend on the order of the keys, and invalid splits are rejected."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets.kitti import drives, related
from robustflow.data.datasets.split import KITTI_SPLIT_SEED, drive_disjoint_split, kitti_split, read_split, selected

KEYS = [f"{number:06d}" for number in range(200)]


@given(order=st.permutations(KEYS), seed=st.integers(0, 5))
@settings(max_examples=20, deadline=None)
def test_default_split_has_80_and_120_pairs_in_any_order(order: list[str], seed: int) -> None:
    evaluation, training = kitti_split(KEYS, seed)
    assert len(evaluation) == 80
    assert sorted(evaluation + training) == KEYS
    assert evaluation == sorted(evaluation)
    shuffled = kitti_split(order, seed)
    assert set(shuffled.evaluation) == set(evaluation)
    assert shuffled.evaluation == [key for key in order if key in set(evaluation)]


def test_the_seed_matters_and_the_default_is_fixed() -> None:
    """Golden values: the first pairs of the project's split, on which published numbers are based."""
    assert kitti_split(KEYS, 1) != kitti_split(KEYS, 2)
    assert kitti_split(KEYS) == kitti_split(KEYS, KITTI_SPLIT_SEED)
    first = [int(key) for key in kitti_split(KEYS).evaluation[:8]]
    assert first == [0, 1, 3, 5, 7, 8, 9, 10]


@given(count=st.integers(1, 199))
def test_fewer_than_200_pairs_are_all_evaluated(count: int) -> None:
    assert kitti_split(KEYS[:count]) == (KEYS[:count], [])


def test_no_drive_is_on_both_sides_of_the_drive_disjoint_split() -> None:
    for seed in range(5):
        evaluation, training = drive_disjoint_split(KEYS, seed)
        assert (len(evaluation), len(training)) == (80, 120)
        assert sorted(evaluation + training) == KEYS
        assert not related(evaluation, training)
    assert related(*kitti_split(KEYS))
    known = drives("kitti2015")
    assert len({known[key] for key in drive_disjoint_split(KEYS).evaluation if key in known}) >= 10


def test_the_drive_disjoint_split_is_fixed() -> None:
    """Golden values: the first pairs of the split."""
    assert [int(key) for key in drive_disjoint_split(KEYS).evaluation[:8]] == [0, 1, 4, 5, 6, 22, 23, 24]
    some = KEYS[::3]
    assert drive_disjoint_split(some).evaluation == [k for k in some if k in drive_disjoint_split(KEYS).evaluation]


def test_split_is_loaded_by_name(tmp_path: Path) -> None:
    assert selected("drive-disjoint", KEYS, "kitti2015") == drive_disjoint_split(KEYS).evaluation
    path = tmp_path / "split.txt"
    path.write_text("000010")
    assert selected(path, KEYS, "kitti2015") == ["000010"]
    with pytest.raises(UsageError, match="split of KITTI 2015, not of sintel"):
        selected("drive-disjoint", KEYS, "sintel")
    with pytest.raises(UsageError, match="not of kitti_fc_released"):
        selected("drive-disjoint", KEYS, "kitti_fc_released")
    with pytest.raises(DataError, match="none of these 1 pairs"):
        selected("drive-disjoint", drive_disjoint_split(KEYS).training[:1], "kitti2015")


def test_split_file_has_one_key_per_line(tmp_path: Path) -> None:
    path = tmp_path / "split.txt"
    path.write_text("\ufeff# mine\r\n000010\r\n\r\n 000002 \r\n", encoding="utf-8")
    assert read_split(path, KEYS) == ["000002", "000010"]


def test_split_file_of_zeros_and_ones_selects_the_ones(tmp_path: Path) -> None:
    path = tmp_path / "split.txt"
    path.write_text("0\n1\n1\n")
    assert read_split(path, ["a", "b", "c"]) == ["b", "c"]
    path.write_text("0 \n1\n")
    assert read_split(path, ["0", "1", "2"]) == ["0", "1"]  # keys that look like special marks are ordinary keys


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("000010\n00011\n", r"no sample '00011' in the dataset \(1 of 2 are unknown\); did you mean '0"),
        ("000010\n000010\n", "'000010' is listed twice"),
        ("0\n1\n", "2 zeros and ones for 200 pairs"),
        ("0\n" * 200, "selects no sample"),
        ("# nothing\n\n", "selects no sample"),
        ("\x00\xff\xfe", "not a text file"),
    ],
)
def test_invalid_split_files_are_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "split.txt"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError, match=match) as caught:
        read_split(path, KEYS)
    assert str(path) in str(caught.value)


def test_missing_split_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="No such file"):
        read_split(tmp_path / "missing.txt", KEYS)


def test_endless_device_as_split_file_is_refused() -> None:
    with pytest.raises(DataError, match="/dev/zero: larger than"):
        read_split("/dev/zero", KEYS)
