"""Datasets and benchmarks: their facts, names and options; KITTI's drives, sky and splits."""

import csv
import pickle
import sys
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import AssetError, DataError, UsageError
from robustflow.corruptions import IMAGE_PAIR, PAPER_ORDER
from robustflow.data.benchmarks import BENCHMARKS, BenchmarkFacts, benchmark_facts, load_benchmark
from robustflow.data.datasets import DATASETS, Dataset, PreCorrupted, dataset_facts, load_dataset
from robustflow.data.datasets.kitti import drive_groups, drives, related, sky
from robustflow.data.datasets.split import KITTI_SPLIT_SEED, drive_disjoint_split, kitti_split, read_split, selected
from robustflow.models.provenance import TRAINING_SETS
from tests.refusals import refusal
from tests.shared_data import shared_folder

from .layouts import picture

OURS = [name for name in DATASETS.names() if DATASETS.get(name).__module__.startswith("robustflow.")]
KEYS = [f"{number:06d}" for number in range(200)]


@pytest.mark.parametrize("name", OURS)
def test_each_data_set_states_licence_citation_layout_and_truth(name):
    facts = dataset_facts(name)
    assert all((facts.description, facts.layout, facts.citation))
    assert facts.licence != "not stated"
    assert "://" not in facts.model_dump_json()
    assert facts.training_set in ("", *TRAINING_SETS.values())
    assert set(facts.same_domain) <= set(TRAINING_SETS.values())
    has_flow = getattr(DATASETS.get(name), "has_flow", None)
    assert facts.ground_truth in (("dense", "sparse") if has_flow else ("none",))


def test_facts_of_kitti_fc_and_gopro_fc_equal_the_paper():
    facts = [benchmark_facts(name) for name in ("kitti-fc", "gopro-fc")]
    assert [(each.title, each.has_flow, each.paper_pairs, each.paper_corruptions) for each in facts] == [
        ("KITTI-FC", True, 80, IMAGE_PAIR),
        ("GoPro-FC", False, 675, PAPER_ORDER),
    ]
    assert [name for name in BENCHMARKS.names() if benchmark_facts(name).published] == ["kitti-fc", "gopro-fc"]
    assert load_benchmark("demo").facts is benchmark_facts("demo")


def test_a_data_set_as_a_benchmark_has_its_facts():
    assert benchmark_facts("gopro").has_flow is False
    about = dataset_facts("sintel")
    assert benchmark_facts("sintel") == BenchmarkFacts(
        title="MPI-Sintel", description=about.description, data=about.layout, training_set="sintel"
    )


def test_an_unknown_name_gives_neutral_facts_and_loads_no_code():
    sys.modules.pop("antigravity", None)
    for name in ("antigravity:Benchmark", "os:system", "", "x" * 5000):
        facts = benchmark_facts(name)
        assert (facts.published, facts.paper_pairs, facts.training_set, facts.same_domain) == (False, None, "", ())
        assert facts.title == (name[:80] or "unnamed")
    assert "antigravity" not in sys.modules
    assert dataset_facts("antigravity:Set").licence == "not stated"


def test_motorcycle_is_a_dataset_without_a_folder(monkeypatch, tmp_path):
    dataset = load_dataset("motorcycle")
    assert isinstance(dataset, Dataset)
    assert not isinstance(dataset, PreCorrupted)
    assert pickle.loads(pickle.dumps(dataset)).keys() == dataset.keys()
    assert [path.is_file() for path in dataset.files("motorcycle")] == [True] * 3
    refusal(lambda: dataset.load("bicycle"), UsageError, "bicycle")
    refusal(lambda: load_dataset("motorcycle", tmp_path), UsageError, "--data")
    monkeypatch.setattr("skimage.__file__", str(tmp_path / "__init__.py"))
    refusal(lambda: load_dataset("motorcycle"), AssetError, tmp_path / "data" / "motorcycle_left.png")


@pytest.mark.parametrize(
    ("name", "options", "culprit", "suggested"),
    [
        ("kitti_2015", {}, "kitti_2015", "kitti2015"),
        ("gopro", {"stpe": 2}, "stpe", "step"),
        ("kitti_fc_released", {"split": "eval"}, "split", "val, training"),
        ("flyingthings3d", {"render_pass": "albedo"}, "render_pass", "clean, final"),
        ("kitti_multiview", {"camera": "middle"}, "camera", "both, left, right"),
        ("kitti_raw", {"camera": "middle"}, "camera", "left, right, both"),
        ("folder", {"step": 0}, "step", "0"),
    ],
)
def test_unknown_names_and_options_are_refused_with_the_known_ones(tmp_path, name, options, culprit, suggested):
    assert suggested in str(refusal(lambda: load_dataset(name, tmp_path, **options), UsageError, culprit))


def test_a_data_set_is_a_sequence(tmp_path):
    for number in range(4):
        picture(tmp_path / f"{number}.png")
    pairs = load_dataset("folder", tmp_path)
    assert len(pairs) == 3
    assert repr(pairs) == "<OwnFrames: 3 pairs, no ground truth>"
    assert [sample.key for sample in pairs] == pairs.keys() == ["0", "1", "2"]
    assert (pairs[0].key, pairs[-1].key, pairs["1"].key) == ("0", "2", "1")
    with pytest.raises(IndexError):
        pairs[3]
    refusal(lambda: pairs["9"], UsageError, "9")


def test_the_table_of_drives_is_that_of_the_development_kit():
    known = drives("kitti2015")
    assert (len(known), len(set(known.values()))) == (142, 29)
    assert known["000010"] == "2011_09_26_drive_0009"  # the example in the development kit's readme
    assert {key for key, drive in known.items() if drive.endswith("26_drive_0009")} == set(KEYS[7:13])
    assert (known["000002"], known["000199"]) == ("2011_09_26_drive_0005", "2011_10_03_drive_0047")
    assert list(known.values()) == sorted(known.values()), "pairs are numbered in the order of drives"
    assert drives("sintel") == drive_groups("sintel") == {}


def test_pairs_without_a_drive_share_a_group_with_their_neighbours_and_with_no_drive():
    groups, known = drive_groups("kitti2015"), drives("kitti2015")
    assert list(groups) == KEYS
    for first, second in pairwise(KEYS):
        if first not in known and second not in known:
            assert groups[first] == groups[second]
    assert not {groups[key] for key in KEYS if key not in known} & set(known.values())
    assert len(set(groups.values())) == 29 + 10
    groups, known = drive_groups("kitti2012"), drives("kitti2012")
    assert (len(groups), len(known), len(set(known.values()))) == (194, 89, 16)
    assert [groups[key] for key in groups if key not in known] == ["unmapped"] * 105
    assert set(known.values()) & set(drives("kitti2015").values()) == {"2011_09_26_drive_0022"}


def test_evaluated_pairs_are_in_as_many_drives_and_neighbouring_scenes_as_published():
    """The multi-view extension's pairs of other scenes include 17 evaluated pairs: scenes may be ten frames apart."""
    evaluation, training = kitti_split(KEYS)
    known = drives("kitti2015")
    mapped = [key for key in evaluation if key in known]
    assert (len(mapped), len({known[key] for key in mapped})) == (56, 22)
    assert len(related(evaluation, training)) == 45  # four in five evaluated pairs
    assert len({drive_groups("kitti2015")[key] for key in evaluation}) == 30
    table = (files("robustflow.data.datasets") / "data" / "kitti2015_drives.csv").read_text(encoding="utf-8")
    frame_of = {line["pair"]: (line["drive"], int(line["frame"])) for line in csv.DictReader(table.splitlines())}
    begins = (*range(8), *range(13, 20))
    trained = {(drive, frame - 10 + number) for drive, frame in frame_of.values() for number in begins}
    assert sum(frame_of.get(pair) in trained for pair in evaluation) == 17


OPEN = [(slice(0, 60), slice(340, 370)), (slice(10, 60), slice(490, 540)), (slice(0, 90), slice(700, 750))]
"""Boxes of pair 000010 that show only sky."""
HIDDEN = [(slice(60, 100), slice(190, 280)), (slice(30, 90), slice(590, 640)), (slice(130, 375), slice(0, 1242))]
"""Boxes of pair 000010 that show trees, and everything below the highest measured pixel."""


def test_the_sky_of_shared_kitti_pairs_is_found_between_trees_and_not_on_facades():
    data = load_dataset("kitti2015", shared_folder("data", "kitti2015"))
    street, square, trees = (data.load(key) for key in ("000002", "000003", "000010"))
    for sample in (street, square, trees):
        for frame in sample.frames:
            assert not (sky(frame, sample.valid) & sample.valid).any()
    for frame in trees.frames:
        found = sky(frame, trees.valid)
        assert 0.08 < found.mean() < 0.12
        assert min(found[box].mean() for box in OPEN) > 0.99
        assert max(found[box].mean() for box in HIDDEN) < 0.001
    assert sky(square.frames[0], square.valid).mean() < 0.001
    assert sky(street.frames[0], street.valid)[:, 480:].mean() < 0.001


@given(order=st.permutations(KEYS), seed=st.integers(0, 5))
@settings(max_examples=20, deadline=None)
def test_default_split_has_80_and_120_pairs_in_any_order(order: list[str], seed: int) -> None:
    evaluation, training = kitti_split(KEYS, seed)
    assert len(evaluation) == 80
    assert sorted(evaluation + training) == KEYS
    assert evaluation == sorted(evaluation)
    assert kitti_split(order, seed).evaluation == [key for key in order if key in set(evaluation)]


def test_the_splits_are_fixed_and_the_seed_matters() -> None:
    """Golden values: the first pairs of the project's splits, on which published numbers are based."""
    assert kitti_split(KEYS, 1) != kitti_split(KEYS, 2)
    assert kitti_split(KEYS) == kitti_split(KEYS, KITTI_SPLIT_SEED)
    assert [int(key) for key in kitti_split(KEYS).evaluation[:8]] == [0, 1, 3, 5, 7, 8, 9, 10]
    assert [int(key) for key in drive_disjoint_split(KEYS).evaluation[:8]] == [0, 1, 4, 5, 6, 22, 23, 24]
    some = KEYS[::3]
    assert drive_disjoint_split(some).evaluation == [k for k in some if k in drive_disjoint_split(KEYS).evaluation]
    assert kitti_split(KEYS[:199]) == (KEYS[:199], [])


def test_no_drive_is_on_both_sides_of_the_drive_disjoint_split() -> None:
    for seed in range(5):
        evaluation, training = drive_disjoint_split(KEYS, seed)
        assert (len(evaluation), len(training)) == (80, 120)
        assert sorted(evaluation + training) == KEYS
        assert not related(evaluation, training)
    known = drives("kitti2015")
    assert len({known[key] for key in drive_disjoint_split(KEYS).evaluation if key in known}) >= 10


def test_split_is_loaded_by_name_for_kitti_2015_alone() -> None:
    evaluation, training = drive_disjoint_split(KEYS)
    assert selected("drive-disjoint", KEYS, "kitti2015") == evaluation
    for dataset in ("sintel", "kitti_fc_released"):
        refusal(lambda dataset=dataset: selected("drive-disjoint", KEYS, dataset), UsageError, "--split")
    refusal(lambda: selected("drive-disjoint", training[:1], "kitti2015"), DataError, "--split")


@pytest.mark.parametrize(
    ("text", "keys", "chosen"),
    [
        ("\ufeff# mine\r\n000010\r\n\r\n 000002 \r\n", KEYS, ["000002", "000010"]),
        ("0\n1\n1\n", ["a", "b", "c"], ["b", "c"]),
        ("0 \n1\n", ["0", "1", "2"], ["0", "1"]),  # keys that look like marks are ordinary keys
    ],
)
def test_split_file_has_one_key_per_line_or_zeros_and_ones(tmp_path: Path, text, keys, chosen) -> None:
    (tmp_path / "split.txt").write_text(text, encoding="utf-8")
    assert selected(tmp_path / "split.txt", keys, "any") == chosen


@pytest.mark.parametrize(
    "text", ["000010\n00011\n", "000010\n000010\n", "0\n1\n", "0\n" * 200, "# nothing\n\n", "\x00\xff\xfe", None]
)
def test_invalid_split_files_are_refused(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "split.txt"
    if text is not None:
        path.write_bytes(text.encode("latin-1"))
    refusal(lambda: read_split(path, KEYS), DataError, path)
    refusal(lambda: read_split("/dev/zero", KEYS), DataError, "/dev/zero")
