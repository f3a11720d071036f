"""Compare the table of drives with the facts in the development kit's documentation."""

from itertools import pairwise

from robustflow.data.datasets.kitti import Kitti2015, drive_groups, drives, related
from robustflow.data.datasets.split import kitti_split

KEYS = [f"{number:06d}" for number in range(200)]


def test_the_table_is_that_of_the_development_kit():
    known = drives("kitti2015")
    assert (len(known), len(set(known.values()))) == (142, 29)
    assert known["000010"] == "2011_09_26_drive_0009"  # the example in the development kit's readme
    assert {key for key, drive in known.items() if drive.endswith("26_drive_0009")} == set(KEYS[7:13])
    assert (known["000002"], known["000199"]) == ("2011_09_26_drive_0005", "2011_10_03_drive_0047")
    assert list(known.values()) == sorted(known.values()), "pairs are numbered in the order of drives"


def test_evaluated_pairs_are_in_as_many_drives_as_published():
    evaluation, training = kitti_split(KEYS)
    known = drives("kitti2015")
    mapped = [key for key in evaluation if key in known]
    assert (len(mapped), len({known[key] for key in mapped})) == (56, 22)
    assert len(related(evaluation, training)) == 45  # four in five evaluated pairs
    assert len({drive_groups("kitti2015")[key] for key in evaluation}) == 30


def test_pairs_without_a_drive_share_a_group_with_their_neighbours_and_with_no_drive():
    groups, known = drive_groups("kitti2015"), drives("kitti2015")
    assert list(groups) == KEYS
    for first, second in pairwise(KEYS):
        if first not in known and second not in known:
            assert groups[first] == groups[second]
    assert not {groups[key] for key in KEYS if key not in known} & set(known.values())
    assert len(set(groups.values())) == 29 + 10


def test_kitti2012_has_a_separate_table_of_drives():
    groups, known = drive_groups("kitti2012"), drives("kitti2012")
    assert (len(groups), len(known), len(set(known.values()))) == (194, 89, 16)
    assert [groups[key] for key in groups if key not in known] == ["unmapped"] * 105
    assert set(known.values()) & set(drives("kitti2015").values()) == {"2011_09_26_drive_0022"}


def test_other_datasets_have_no_drives():
    assert drives("sintel") == drive_groups("sintel") == {}


def test_samples_have_their_drive_as_group(shared):
    dataset = Kitti2015(shared("data/kitti2015"))
    keys = dataset.keys()
    groups = {key: dataset.load(key).group for key in keys}
    assert groups == {key: drive_groups("kitti2015")[key] for key in groups}
    assert groups["000002"] == groups["000003"] == "2011_09_26_drive_0005"
