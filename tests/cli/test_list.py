"""Test the command `list`: the available names, and the training data of each model's checkpoints."""

from __future__ import annotations

import re

import pytest

from robustflow.corruptions.optics.psf_field import RMS_RADII

LISTED = {"models": "farneback", "corruptions": "glass_blur", "benchmarks": "kitti-fc", "datasets": "sintel"}


@pytest.mark.parametrize("kind", [*LISTED, "all"])
def test_list_prints_every_kind_of_name(robustflow, kind):
    out = robustflow.prints("list", kind)
    first_words = {line.split()[0].rstrip(":") for line in out.splitlines() if line}
    for name, listed in LISTED.items():
        assert (listed in first_words) == (kind in (name, "all"))


def test_the_list_of_corruptions_states_the_rms_radii_of_the_lenses_that_are_used(robustflow):
    *_, last = robustflow.prints("list", "corruptions").splitlines()
    assert last.startswith("psf_blur: ")
    assert all(f"{radius:.4f}" in last for radius in RMS_RADII)


def test_the_list_of_models_says_what_their_checkpoints_have_seen(robustflow):
    out = robustflow.prints("list", "models")
    lines = {line.split()[0]: line for line in out.splitlines()}
    for fact in ("things OOD", "kitti LEAKED", "2020", "BSD-3-Clause"):
        assert fact in lines["raft"]
    assert "UNKNOWN" in lines["arflow"]
    assert "knowledge" in lines["farneback"]
    assert lines["dis"].endswith("not trained")
    assert lines["tiny"].endswith("shipped OOD")
    assert "things288960 OOD" in lines["flowformer_pp"]
    assert "splatflow (cupy, for CUDA)" in out
    for name in ("precomputed", "onnx"):
        assert re.search(r"^\w+ +any +your files +(yes|needs \[\w+\]) +a.* UNKNOWN$", lines[name])
    assert lines["memfof"].endswith("kitti LEAKED, sintel LEAKED, spring LEAKED, tartan OOD, things OOD, tskh LEAKED")


def test_search_for_models_lists_what_each_of_their_checkpoints_saw(robustflow):
    out = robustflow.prints("list", "models", "sea_raft_m")
    _, _, spring = out.partition("sea_raft_m spring: ")
    assert spring.startswith("LEAKED on kitti-fc, LEAKED on sintel, OOD on gopro-fc; trained on")
    assert spring.splitlines()[1].startswith("    confidence high: the name hides KITTI")
    assert robustflow.prints("list", "models", "SEA-RAFT-m") == out
    assert robustflow.prints("list", "models", "FlowFormer++").startswith("flowformer_pp chairs: ")
    assert robustflow.prints("list", "models", "farneback") == "farneback: no published checkpoints\n"
    for arguments in (("models", "sea_rafd"), ("corruptions", "fog")):
        robustflow.refuses("list", *arguments)
