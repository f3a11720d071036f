"""Which of the paper's variants can be run here, and with which weights."""

import hashlib

import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.models.catalog import checkpoints
from robustflow.paper import plan as weights_module
from robustflow.paper.plan import FoundWeights, Missing, Runnable, Variant, choose, paper_variants, weights_in

from ..refusals import refusal

RAFT = [Variant("RAFT", "OOD", "raft"), Variant("RAFT", "ID", "raft")]


def _entry(model, checkpoint):
    return next(entry for entry in checkpoints() if (entry.model, entry.checkpoint) == (model, checkpoint))


def _found(model, checkpoint):
    entry = _entry(model, checkpoint)
    return FoundWeights(weights_module.Path(entry.file), entry.sha256, entry, entry.file.rpartition(".")[0])


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The choice does not depend on the installed libraries."""
    monkeypatch.setattr("robustflow.paper.plan.is_installed", lambda method: True)


def test_plan_without_weights_runs_the_two_classical_methods():
    choices = choose(paper_variants("kitti-fc"), "kitti-fc", [])
    assert [choice.variant.model for choice in choices if isinstance(choice, Runnable)] == ["farneback", "dis_rgb"]
    assert len(choices) == 29
    missing = {choice.variant: choice for choice in choices if isinstance(choice, Missing)}
    assert "releases/download/weights1/raft-things-802bbcfd.ckpt" in missing[RAFT[0]].remedy
    assert "--recipe ood" in missing[RAFT[0]].remedy
    assert "http" not in missing[RAFT[1]].remedy  # no public checkpoint corresponds to this variant
    assert "--recipe id" in missing[RAFT[1]].remedy
    assert all(choice.remedy for choice in missing.values())
    proposed = [missing[Variant("SAMFlow-H", setting, "samflow_h")].remedy for setting in ("OOD", "ID")]
    assert ["authors' file" in remedy for remedy in proposed] == [True, False]  # one file cannot be both
    specs = {choice.variant.model: choice.ref for choice in choices if isinstance(choice, Runnable)}
    assert specs["farneback"].options == (("preset", "opencv"),)


def test_checkpoint_trained_on_the_evaluated_pairs_is_not_used():
    out, inside = choose(RAFT, "kitti-fc", [_found("raft", "kitti")])
    assert isinstance(out, Missing)
    assert isinstance(inside, Missing)
    assert "LEAKED" in inside.reason


def test_checkpoint_nearest_to_the_papers_is_used():
    found = [_found("raft", name) for name in ("chairs", "kitti", "things", "sintel")]
    kitti = choose(RAFT[:1], "kitti-fc", found)[0]
    gopro = choose(RAFT[:1], "gopro-fc", found)[0]
    assert kitti.ref.checkpoint == "raft-things-802bbcfd.ckpt"
    assert "stand-in raft things, trained on flyingchairs, flyingthings3d" in kitti.weights
    assert gopro.ref.checkpoint == "raft-sintel-fb44381e.ckpt"


def test_file_named_as_the_variant_takes_precedence(tmp_path):
    training = tmp_path / "raft-id"
    training.mkdir()
    (training / "last.pth").write_bytes(b"of a training")
    (tmp_path / "raft-ood.pth").write_bytes(b"mine")
    found = [*weights_in([tmp_path]), _found("raft", "things")]
    out, inside = choose(RAFT, "kitti-fc", found)
    assert out.ref.checkpoint == str(tmp_path / "raft-ood.pth")
    assert inside.ref.checkpoint == str(training / "last.pth")
    assert out.folder == f"raft-ood-{hashlib.sha256(b'mine').hexdigest()[:8]}"


def test_random_weights_are_used_only_if_allowed():
    out, inside = choose(RAFT, "kitti-fc", [], random=True)
    assert out.random
    assert "RANDOM" in out.weights
    assert out.folder == inside.folder


def test_catalogue_recognises_files_by_content_and_not_by_name(tmp_path, monkeypatch):
    entry = _entry("raft", "things").model_copy(update={"sha256": hashlib.sha256(b"weights").hexdigest()[:8]})
    monkeypatch.setattr(weights_module, "checkpoints", lambda: (entry,))
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "anything.pth").write_bytes(b"weights")
    (tmp_path / entry.file).write_bytes(b"changed on the way")
    (tmp_path / "README.txt").write_bytes(b"weights")
    renamed, altered = weights_in([tmp_path])
    assert (renamed.entry, renamed.altered) == (entry, None)
    assert (altered.entry, altered.altered) == (None, entry)
    assert "wrong hash" in choose(RAFT[:1], "kitti-fc", [altered])[0].reason
    refusal(lambda: weights_in([tmp_path / "none"]), DataError, tmp_path / "none")


def test_dis_of_the_paper_is_run_with_dis_rgb_by_default():
    assert [variant.model for variant in paper_variants("kitti-fc", ["DIS"])] == ["dis_rgb"]
    assert "grey" in choose(paper_variants("kitti-fc", ["dis"]), "kitti-fc", [])[0].weights
    refusal(lambda: paper_variants("kitti-fc", ["dis", "dis_rgb"]), UsageError, "DIS")
    refusal(lambda: paper_variants("kitti-fc", ["memflow"]), UsageError, "memflow")


@pytest.mark.slow
@pytest.mark.torch
def test_checkpoint_addresses_equal_those_of_the_libraries():
    ptlflow = pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    optical_flow = pytest.importorskip("torchvision", reason="needs the torch extra").models.optical_flow
    known = {
        weights.url for kind in (optical_flow.Raft_Large_Weights, optical_flow.Raft_Small_Weights) for weights in kind
    }
    for name in ptlflow.get_model_names():
        known |= {*getattr(ptlflow.get_model_reference(name), "pretrained_checkpoints", {}).values()}
    published = {entry.address for entry in checkpoints() if not entry.model.startswith("ptlflow:")}
    assert published <= known
