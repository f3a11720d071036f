"""A model's training sets determine its setting, without any guessing."""

import csv
import re

import pytest

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.data.benchmarks.setting import Provenance, provenance_of
from robustflow.data.benchmarks.setting import setting_of as setting_on
from robustflow.data.datasets import DATASETS, dataset_facts
from robustflow.data.datasets.split import drive_disjoint_split, kitti_split
from robustflow.models import MODELS, ModelRef
from robustflow.models.catalog import PTLFLOW, checkpoints, entries_of, methods
from robustflow.models.provenance import TRAINING_SETS, Training, parse_training_sets, training_of, training_of_entry
from robustflow.stats.published.tables import published_methods
from robustflow.testing import BrightnessFlow


def test_catalog_lists_exactly_the_models_of_this_package():
    of_any_method = {"precomputed", "onnx"}  # regardless of the file's contents
    assert set(methods()) == set(MODELS.names()) - of_any_method


def test_every_method_of_the_paper_has_the_papers_year_and_type():
    entries = methods().values()
    for name, method in published_methods().items():
        variants = [entry for entry in entries if entry.method == name or entry.method.startswith(f"{name}-")]
        assert {(entry.year, entry.type) for entry in variants} == {(method.year, method.type)}, name


def test_catalog_entries_are_consistent():
    names = [(entry.model, entry.checkpoint) for entry in checkpoints()]
    assert len(set(names)) == len(names)
    for entry in checkpoints():
        assert f"-{entry.sha256}." in entry.file
        assert {name.removesuffix("?") for name in entry.trained_on.split("+")} <= set(TRAINING_SETS.values())
        assert entry.confidence == "high" or entry.note, "a note must explain every uncertain entry"


def test_the_catalog_agrees_with_the_list_of_checkpoints(shared):
    """The shared lists contain each checkpoint's label on three benchmarks, determined independently of this code."""
    expected = {}
    # torchvision's checkpoints are only listed here, without a label on Sintel
    with shared("checkpoints.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            sintel = "OOD" if row["saw_sintel"] == "no" else "LEAKED"
            expected[row["ptlflow_file"]] = (row["label_kitti_fc"], sintel, row["label_gopro_fc"])
    with shared("checkpoints-all.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            labels = tuple(row[f"label_{name}_fc"] for name in ("kitti", "sintel", "gopro"))
            expected[row["ptlflow_file"]] = labels
    assert set(expected) == {entry.file for entry in checkpoints()}
    for entry in checkpoints():
        settings = tuple(setting_on(training_of_entry(entry), name) for name in ("kitti-fc", "sintel", "gopro-fc"))
        assert settings == expected[entry.file], (entry.model, entry.checkpoint)


def test_a_backbone_of_unchecked_pre_training_is_a_second_fact_beside_the_setting_of_the_flow_training():
    """31 checkpoints of FlowSeek and WAFT contain Depth Anything V2, DINOv3 or Twins."""
    unchecked = [entry for entry in checkpoints() if entry.backbone.endswith("?")]
    assert len(unchecked) == 31
    settings = {setting_on(training_of_entry(entry), "kitti-fc") for entry in unchecked}
    assert settings == {"OOD", "UNKNOWN", "LEAKED"}
    (things,) = (entry for entry in unchecked if (entry.model, entry.checkpoint) == ("flowseek_t", "things"))
    provenance = provenance_of(training_of_entry(things), "kitti-fc")
    assert (provenance.setting, provenance.trained_on) == ("OOD", ("flyingchairs", "flyingthings3d"))
    assert provenance.backbone_note.startswith("backbone depth-anything-v2, ")
    (flowformer,) = (one for one in checkpoints() if (one.model, one.checkpoint) == ("flowformer", "things"))
    assert provenance_of(training_of_entry(flowformer), "kitti-fc").backbone_note == "backbone imagenet"


def test_no_checkpoint_of_ptlflow_is_left_out():
    pytest.importorskip("torch", reason="needs the ptlflow extra")
    ptlflow = pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    for name in ptlflow.get_model_names():
        published = getattr(ptlflow.get_model_reference(name), "pretrained_checkpoints", None) or {}
        assert {entry.checkpoint for entry in entries_of(f"{PTLFLOW}{name}")} == set(published), name


@pytest.mark.parametrize(
    ("sets", "benchmark", "setting"),
    [
        ("C+T", "kitti-fc", "OOD"),
        ("C+T>K:train", "kitti-fc", "ID"),
        ("C+T>K:train", "kitti2015", "LEAKED"),  # evaluated whole
        ("C+T>K:drive-disjoint", "kitti-fc", "LEAKED"),
        ("C+T+S+K+H", "kitti-fc", "LEAKED"),
        ("C+T+S+K+H", "gopro-fc", "OOD"),
        ("kitti-raw", "kitti-fc", "ID"),
        ("kitti2012", "kitti-fc", "ID"),
        ("K", "kitti2012", "ID"),
        ("K:train", "kitti2012", "ID"),
        ("K:drive-disjoint", "kitti2012", "ID"),
        ("K:released", "kitti2012", "ID"),
        ("C+T+K:drive-disjoint", "kitti2012", "ID"),
        ("C,S", "sintel", "LEAKED"),
        ("G:train", "gopro-fc", "ID"),
        ("S:train", "sintel", "UNKNOWN"),  # evaluated whole: the training part of a split that is not known
        ("K12:train", "kitti2012", "UNKNOWN"),
        ("S:train", "kitti-fc", "OOD"),
        ("M", "demo", "LEAKED"),
        ("FS:train", "shapes", "ID"),  # its splits share nothing, and a run evaluates the other one
        ("FS:train", "shapes-still", "ID"),
        ("FS", "shapes", "LEAKED"),
        ("X", "spring", "OOD"),
        ("C", "folder", "UNKNOWN"),
        ("C+T+K?", "kitti-fc", "UNKNOWN"),
        ("C+T+K12?", "kitti-fc", "UNKNOWN"),
        ("C+T+K+K12?", "kitti-fc", "LEAKED"),
        ("C+T+K?", "sintel", "OOD"),
    ],
)
def test_setting_follows_from_training_sets_and_benchmark(sets, benchmark, setting):
    assert setting_on(training_of({"name": "mine", "checkpoint": "ab" * 32}, sets), benchmark) == setting


def _on(benchmark: str, sets: str, keys: list[str], **protocol: object) -> tuple[str, list[int]]:
    """The setting of a model trained on these sets, and the numbers in its note."""
    training = training_of({"name": "mine", "checkpoint": "ab" * 32}, sets)
    provenance = provenance_of(training, benchmark, keys, protocol)
    return provenance.setting, [int(number) for number in re.findall(r"\b\d+\b", provenance.note)]


KEYS = [f"{number:06d}" for number in range(200)]
EVALUATED, TRAINING = kitti_split(KEYS)
RELEASED = {"frames": "released"}


@pytest.mark.parametrize(
    ("sets", "keys", "protocol", "setting", "numbers"),
    [
        ("K:train", EVALUATED, {}, "ID", [45, 56]),  # 45 of 56 share a drive with training pairs
        ("K:drive-disjoint", drive_disjoint_split(KEYS).evaluation, {}, "ID", []),
        ("K:train", [*EVALUATED[:3], TRAINING[0]], {}, "LEAKED", [1, 4]),  # a --split file with one training pair
        ("K:train", ["000002", "000003"], {}, "LEAKED", [1, 2]),  # a small folder, all of which is evaluated
        ("K:train", EVALUATED, RELEASED, "UNKNOWN", None),
        ("K:released", EVALUATED, RELEASED, "ID", None),
        ("K:released", EVALUATED, {}, "UNKNOWN", None),
        ("K:train", ["a", "b"], {}, "UNKNOWN", None),
        ("KR", EVALUATED, {}, "ID", [56, 80]),
        ("KR:train", EVALUATED, {}, "ID", []),
    ],
)
def test_setting_on_kitti_follows_from_the_evaluated_pairs(sets, keys, protocol, setting, numbers):
    found = _on("kitti-fc", sets, keys, **protocol)
    assert found == (setting, found[1] if numbers is None else numbers)


def test_generated_pairs_of_the_training_split_are_leaked():
    assert _on("shapes", "FS:train", ["000000"], options={"split": "train"})[0] == "LEAKED"
    assert _on("shapes", "FS:train", ["000000"], options={"pairs": "9", "split": "test"})[0] == "ID"


@pytest.mark.parametrize(("sets", "setting"), [("C+T", "OOD"), ("G", "LEAKED"), ("G:train", "ID")])
def test_a_video_of_the_user_is_not_of_gopros_domain_because_gopro_fc_reads_it(sets, setting):
    for keys in (["bikes/000124"], ["GOPR0374_11_02/000032", "bikes/000124"]):
        assert _on("gopro-fc", sets, keys) == ("UNKNOWN", [1])
    assert _on("gopro-fc", sets, ["GOPR0374_11_02/000032"])[0] == setting


def test_run_is_leaked_after_a_call_with_training_pairs():
    by_hand = Training(sets=("kitti2015:train",), basis="declared", note="by hand")
    first = provenance_of(by_hand, "kitti-fc", ["000000"])
    assert (first.setting, first.note) == ("ID", "by hand")
    later = provenance_of(by_hand, "kitti-fc", ["000000", "000002"])
    assert later.setting == "LEAKED"
    assert later.note.startswith("by hand; ")


def test_every_data_set_that_models_train_on_has_a_name():
    frames_of = {name: dataset_facts(name).training_set for name in DATASETS.names()}
    assert {name for name in frames_of.values() if name} <= set(TRAINING_SETS.values())
    assert {name for name, training_set in frames_of.items() if not training_set} == {"folder", "robustspring"}


def test_known_file_is_recognised_by_its_hash_despite_a_declaration():
    digest = "3a831a4b" + "0" * 56
    training = training_of({"name": "raft", "checkpoint": digest}, "C")
    assert training.basis == "catalog: raft kitti"
    assert setting_on(training, "kitti-fc") == "LEAKED"
    assert setting_on(training_of({"name": "gma", "checkpoint": digest}), "kitti-fc") == "UNKNOWN"
    assert setting_on(training_of({"name": "raft", "checkpoint": "3a831a4b"}), "kitti-fc") == "UNKNOWN"


def test_random_weights_are_untrained():
    assert setting_on(training_of({"name": "raft", "checkpoint": "random"}, "C+T"), "kitti-fc") == "untrained"


@pytest.mark.parametrize("text", ["", "C+Q", "kiti2015", "K:test", "K:", "C++T+"])
def test_unknown_training_sets_are_refused(text):
    with pytest.raises(UsageError):
        parse_training_sets(text)


def test_a_declaration_is_shown_and_changes_no_identity(tmp_path):
    """A run can be resumed unchanged if the training sets are declared later."""
    runs = []
    for declared in (None, "C+T", "M"):
        options = (("preset", "ultrafast"), *((("trained_on", declared),) if declared else ()))
        spec = ModelRef.parse("robustflow.models.opencv:Dis", options)
        runs.append(rf.evaluate(spec, output=tmp_path / "run", corruptions=["contrast"], severities=[1]))
    # a user-defined model, by module and attribute, although its name is dis
    assert {run.manifest.identity_digest for run in runs} == {runs[0].manifest.identity_digest}
    assert runs[2].rows.equals(runs[0].rows)


class Mine(BrightnessFlow):
    """A model that declares its training sets."""

    trained_on = "C+T>M:train"


def test_own_model_states_its_training_sets(tmp_path):
    run = rf.evaluate(Mine(), output=tmp_path / "a", corruptions=["contrast"], severities=[1])
    assert run.manifest.provenance == Provenance(
        setting="ID", trained_on=("flyingchairs", "flyingthings3d", "middlebury:train"), basis="declared"
    )
    assert run.setting == "ID"
    silent = rf.evaluate(lambda a, b: Mine().predict(a, b), output=tmp_path / "b", corruptions=["contrast"])
    assert silent.setting == "UNKNOWN"
