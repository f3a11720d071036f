"""Each built-in dataset and benchmark defines its facts once, and unknown names get neutral facts."""

import sys

import pytest

from robustflow.corruptions import IMAGE_PAIR, PAPER_ORDER
from robustflow.data.benchmarks import BENCHMARKS, BenchmarkFacts, benchmark_facts, load_benchmark
from robustflow.data.datasets import DATASETS, dataset_facts
from robustflow.models.provenance import TRAINING_SETS

OURS = [name for name in DATASETS.names() if DATASETS.get(name).__module__.startswith("robustflow.")]


@pytest.mark.parametrize("name", OURS)
def test_each_data_set_states_licence_citation_and_layout(name):
    facts = dataset_facts(name)
    assert all((facts.description, facts.layout, facts.citation))
    assert facts.licence != "not stated"
    assert "://" not in facts.model_dump_json()
    assert facts.training_set in ("", *TRAINING_SETS.values())
    assert set(facts.same_domain) <= set(TRAINING_SETS.values())


@pytest.mark.parametrize("name", OURS)
def test_data_sets_have_ground_truth_as_stated(name):
    target = DATASETS.get(name)
    has_flow = getattr(target, "has_flow", None)
    assert dataset_facts(name).ground_truth in (("dense", "sparse") if has_flow else ("none",))


def test_facts_of_kitti_fc_and_gopro_fc_equal_the_paper():
    facts = [benchmark_facts(name) for name in ("kitti-fc", "gopro-fc")]
    assert [(each.title, each.has_flow, each.paper_pairs, each.paper_corruptions) for each in facts] == [
        ("KITTI-FC", True, 80, IMAGE_PAIR),
        ("GoPro-FC", False, 675, PAPER_ORDER),
    ]
    assert [name for name in BENCHMARKS.names() if benchmark_facts(name).published] == ["kitti-fc", "gopro-fc"]


def test_a_data_set_as_a_benchmark_has_its_facts():
    assert benchmark_facts("gopro").has_flow is False
    assert benchmark_facts("sintel") == BenchmarkFacts(
        title="MPI-Sintel",
        description=dataset_facts("sintel").description,
        data=dataset_facts("sintel").layout,
        training_set="sintel",
    )


def test_an_unknown_name_gives_neutral_facts_and_loads_no_code():
    sys.modules.pop("antigravity", None)
    for name in ("antigravity:Benchmark", "os:system", "", "x" * 5000):
        facts = benchmark_facts(name)
        assert (facts.published, facts.paper_pairs, facts.training_set, facts.same_domain) == (False, None, "", ())
        assert facts.title == (name[:80] or "unnamed")
    assert "antigravity" not in sys.modules
    assert dataset_facts("antigravity:Set").licence == "not stated"


def test_an_opened_benchmark_carries_its_facts():
    assert load_benchmark("demo").facts is benchmark_facts("demo")


def test_list_prints_the_facts(robustflow):
    printed = robustflow.prints("list", "datasets")
    for words in ("CC BY-NC-SA 3.0", "Menze and Geiger", "training/flow_occ", "200 pairs", "22,872 pairs"):
        assert words in printed
    printed = robustflow.prints("list", "benchmarks")
    assert "kitti-fc: 80 driving pairs under 20 corruptions." in printed
    assert "RCRE (no ground truth)" in printed
