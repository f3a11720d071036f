"""Test the command `list`: the available names, and the training data of each model's checkpoints."""

from __future__ import annotations

import re

import pytest

from robustflow.models.registry import EXPORTED

LISTED = {"models": "farneback", "corruptions": "glass_blur", "benchmarks": "kitti-fc", "datasets": "sintel"}


@pytest.mark.parametrize("kind", [*LISTED, "all"])
def test_list(robustflow, kind):
    code, out, _ = robustflow("list", kind)
    assert code == 0
    first_words = {line.split()[0].rstrip(":") for line in out.splitlines() if line}
    for name, listed in LISTED.items():
        assert (listed in first_words) == (kind in (name, "all"))


def test_the_list_of_models_says_what_their_checkpoints_have_seen(robustflow):
    _, out, _ = robustflow("list", "models")
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert "things OOD" in lines["raft"]
    assert "kitti LEAKED" in lines["raft"]
    assert "2020" in lines["raft"]
    assert "BSD-3-Clause" in lines["raft"]
    assert "UNKNOWN" in lines["arflow"]
    assert "knowledge" in lines["farneback"]
    assert lines["dis"].endswith("not trained")
    assert lines["tiny"].endswith("shipped OOD")
    assert "things288960 OOD" in lines["flowformer_pp"]
    assert "splatflow (cupy, for CUDA)" in out
    for name in ("precomputed", *EXPORTED.values()):
        assert re.search(r"^\w+ +any +your files +(yes|needs \[\w+\]) +a.* UNKNOWN$", lines[name])
    assert lines["memfof"].endswith("kitti LEAKED, sintel LEAKED, spring LEAKED, tartan OOD, things OOD, tskh LEAKED")


def test_search_for_models_lists_what_each_of_their_checkpoints_saw(robustflow):
    _, out, _ = robustflow("list", "models", "sea_raft_m")
    lines = out.splitlines()
    spring = next(index for index, line in enumerate(lines) if line.startswith("sea_raft_m spring: "))
    assert lines[spring].startswith(
        "sea_raft_m spring: LEAKED on kitti-fc, LEAKED on sintel, OOD on gopro-fc; trained on"
    )
    assert lines[spring + 1].startswith("    confidence high: the name hides KITTI")
    assert robustflow("list", "models", "SEA-RAFT-m")[1] == out
    assert robustflow("list", "models", "FlowFormer++")[1].startswith("flowformer_pp chairs: ")
    assert robustflow("list", "models", "farneback")[1] == "farneback: no published checkpoints\n"
    for arguments in (("models", "sea_rafd"), ("corruptions", "fog")):
        code, _, error = robustflow("list", *arguments)
        assert code != 0
        assert len(error.splitlines()) == 1
