"""The observations are checked against the published data and against synthetic results with known verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binomtest, spearmanr, ttest_1samp, ttest_ind

from robustflow.analysis.model_result import ModelResult
from robustflow.analysis.observations import observations
from robustflow.analysis.observations.evidence import Evidence
from robustflow.analysis.observations.margin import of_correlation, of_difference, of_majority, of_mean
from robustflow.analysis.published.tables import Method, not_discussed, published_results
from robustflow.analysis.results_file import parse_results

_PUBLISHED = {o.number: o for o in observations(published_results())}


def _part(number: int, words: str):
    return next(part for part in _PUBLISHED[number].parts if words in part.claim)


def test_published_data_give_the_stated_verdicts():
    verdicts = {number: observation.verdict for number, observation in _PUBLISHED.items()}
    assert verdicts == dict.fromkeys((3, 4, 6, 7, 8), "holds") | dict.fromkeys((1, 2, 5, 9, 10), "too little evidence")


def test_correlation_of_uncertain_sign_is_too_little_evidence():
    """CRE against clean EPE in ID: Spearman +0.18 over 14 models, of which three are SAMFlow's sizes."""
    part = _part(1, "CRE grows with clean EPE (ID)")
    assert part.verdict == "too little evidence"
    assert part.numbers["low"] < 0 < part.numbers["high"]
    assert "12 families (14 models)" in part.message
    assert _part(1, "corrupted EPE grows with clean EPE (OOD)").verdict == "holds"


def test_verdicts_are_those_of_intervals_that_scipy_gives():
    evidence = Evidence(published_results(), None)

    def families(setting, kind, value):
        members: dict[str, list[float]] = {}
        for entry in evidence.discussed(setting, kind):
            members.setdefault("SAMFlow" if "SAMFlow" in entry[1] else entry[1], []).append(value(entry))
        return {name: fmean(values) for name, values in members.items()}

    ood, in_domain = (families(setting, "supervised", evidence.crer) for setting in ("OOD", "ID"))
    rises = [in_domain[name] - ood[name] for name in ood]
    low, high = ttest_1samp(rises, 0).confidence_interval()
    assert f"{fmean(rises):+.2f} [{low:+.2f}, {high:+.2f}] over 9 families" in _part(4, "on average over").message
    without = list(families("ID", "unsupervised", evidence.crer).values())
    low, high = ttest_ind(list(in_domain.values()), without, equal_var=False).confidence_interval()
    assert f"[{low:+.2f}, {high:+.2f}] over 9 and 3 families" in _part(3, "lower CREr").message
    exact = binomtest(13, 24).proportion_ci(method="exact")
    assert exact.low < 0.5 < exact.high
    assert _part(9, "under most corruptions").verdict == "too little evidence"


def test_margins_have_their_stated_coverage_and_error_rate():
    rng = np.random.default_rng(0)
    wrong = dict.fromkeys(("mean", "difference", "correlation", "majority"), 0)
    for _ in range(600):
        values, others = rng.normal(0, 1, 9), rng.normal(0, 3, 5)
        made = {
            "mean": of_mean(list(values), "family"),
            "difference": of_difference(list(values), list(others)),
            "correlation": of_correlation(list(values), list(rng.normal(size=9))),
            "majority": of_majority(int(rng.binomial(15, 0.5)), 15, "family"),
        }
        for name, margin in made.items():
            wrong[name] += margin.verdict != "too little evidence"
    assert all(count <= 0.075 * 600 for count in wrong.values()), wrong
    assert wrong["mean"] >= 0.025 * 600


def test_variants_of_one_model_count_once():
    evidence = Evidence(published_results(), None)
    families = {
        "SAMFlow": ("SAMFlow-T", "SAMFlow-H"),
        "RAFT": ("RAFT", "RAFT-small", "RAFT-large", "RAFT (seed 1)"),
        "Mine": ("Mine-small", "Mine_large #2"),
        "Tiny": ("Tiny", "Tiny (all corruptions)"),
        "FlowFormer++": ("FlowFormer++",),
        "T": ("T",),
    }
    for family, names in families.items():
        assert {evidence.family(("own", name)) for name in names} == {family}
    values = {("own", f"net-{size}"): {"clean": 2.0 + i, "average": 20.0 + 3 * i} for i, size in enumerate("tsblh")}
    values |= {("own", "other"): {"clean": 1.0, "average": 9.0}}
    assert set(_verdicts(_results(values)).values()) <= {"too little evidence", "cannot be computed"}


def test_observations_state_numbers_read_off_the_tables_by_hand():
    assert "ID GMA, ID SKFlow, ID CRAFT" in _part(7, "low_light has a higher EPE than high_light, for most").message
    stable = _part(3, "lower CREr").numbers
    assert stable["highest_unsupervised"] == pytest.approx((7.33 - 3.52) / 3.52)
    assert stable["lowest_supervised"] == pytest.approx((9.13 - 3.67) / 3.67)
    noise = _part(5, "291 %").numbers["noise"]
    ood = ((10.82 + 9.75 + 10.95) / 3 - 4.11) / 4.11
    in_domain = ((11.31 + 8.51 + 12.96) / 3 - 1.96) / 1.96
    assert noise == pytest.approx(100 * (in_domain / ood - 1))
    assert _part(9, "under most corruptions").message == "under 13 of 24"
    assert _part(10, "than most CNN").numbers == {"best_samflow": 1.54, "middle_cnn": 1.53}


def _results(values: dict[tuple[str, str], dict[str, float]]):
    lines = ["setting,model,metric,corruption,value"]
    for (setting, model), cells in values.items():
        lines += [f"{setting},{model},epe,{name},{value}" for name, value in cells.items()]
    return parse_results("\n".join(lines), "made.csv", "made")


def _verdicts(results: Sequence[ModelResult], methods=None) -> dict[int, str]:
    return {o.number: o.verdict for o in observations(results, methods)}


def test_verdicts_without_results_are_that_nothing_can_be_computed():
    verdicts = _verdicts([])
    assert set(verdicts.values()) == {"cannot be computed"}
    assert list(verdicts) == list(range(1, 11))


def test_verdicts_reverse_when_the_numbers_are_reversed():
    """Accuracy and robustness correlate positively or negatively; either dark or bright frames are worse."""
    for sign, verdict in ((1, "holds"), (-1, "does not hold")):
        worse, milder = ("low_light", "over_exposure"), ("high_light", "under_exposure")
        same = dict.fromkeys(worse, 5.0 + sign) | dict.fromkeys(milder, 5.0)
        models = {("own", f"m{i}"): {"clean": 2.0 + i, "average": 20.0 + 3 * sign * i, **same} for i in range(6)}
        verdicts = _verdicts(_results(models))
        assert verdicts[1] == verdict
        assert verdicts[7] == verdict


def test_observations_can_be_made_about_own_models():
    """If the user states the kind of each model, the observations about kinds are checked."""
    known = {"encoder": "CNN", "decoder": "", "year": 2025, "source": "own"}
    kinds = dict.fromkeys("ABDE", "supervised") | dict.fromkeys("CF", "unsupervised")
    methods = {name: Method(method=name, type=kind, **known) for name, kind in kinds.items()}
    averages = {"A": 9, "B": 8, "C": 3, "D": 9, "E": 9, "F": 3.5}
    models = {("ID", name): {"clean": 2.0, "average": value} for name, value in averages.items()}
    assert _verdicts(_results(models), methods=methods)[3] == "holds"
    models["ID", "C"]["average"] = 8.5
    assert _verdicts(_results(models), methods=methods)[3] == "too little evidence"
    models["ID", "C"]["average"], models["ID", "F"]["average"] = 19.0, 19.5
    assert _verdicts(_results(models), methods=methods)[3] == "does not hold"
    ood = {("OOD", name): {"clean": 4.0, "average": 5.0} for name in "ABDE"}
    assert _verdicts(_results(models | ood), methods=methods)[4] == "holds"


def _with_worst_cost(*names):
    """Return the published results, changed so that the given models have the highest FLOPs and CREr."""
    worst = {"flops_g": 9e4, "crer_id": 99.0}
    return [
        replace(line, printed_cost=line.printed_cost.model_copy(update=worst))
        if line.printed_cost and line.name in names
        else line
        for line in published_results()
    ]


def test_observation_about_cost_needs_costs():
    without = [replace(line, printed_cost=None) for line in published_results()]
    assert _verdicts(without)[6] == "cannot be computed"
    assert _verdicts(_with_worst_cost("ARFlow"))[6] == "too little evidence", "one of three unsupervised is last"
    assert _verdicts(_with_worst_cost("ARFlow", "UPFlow", "BrightFlow"))[6] == "does not hold"


def test_costs_on_kitti_fc_are_no_evidence_about_gopro_fc():
    gopro = [line for line in published_results() if line.benchmark == "gopro-fc"]
    assert _verdicts(gopro)[6] == "cannot be computed"


def test_samflow_and_flowformer_without_a_common_corruption_have_no_difference():
    def own_part(line):
        sam = "SAM" in line.name
        return {key: value for key, value in line.values.items() if key[1] == "average" or (key[1] == "fog") != sam}

    lines = [line for line in published_results() if line.benchmark == "gopro-fc"]
    parts = observations([replace(line, values=own_part(line)) for line in lines])[9].parts
    assert "None" not in " ".join(part.message for part in parts)
    assert "mean of SAMFlow - FlowFormer unknown" in parts[0].message


def test_models_of_equal_error_have_no_correlation():
    first = observations(_results({("OOD", name): {"clean": 2, "average": 5} for name in "ABCDE"}))[0]
    assert first.verdict == "cannot be computed"
    assert "all models have the same" in first.parts[0].message


def _with_pairs(results, pairs):
    """Copies of the entries that appear to be measured on `pairs` pairs."""
    run = SimpleNamespace(summary=SimpleNamespace(samples=pairs))
    return [replace(line, run=run) for line in results]


def test_two_models_or_three_pairs_are_too_little_evidence():
    everything = observations(published_results())
    few = observations(_with_pairs(published_results(), 3))
    for whole, thin in zip(everything, few, strict=True):
        assert any(part.verdict != "cannot be computed" for part in whole.parts)
        assert thin.verdict == "too little evidence"
        weighed = [part for part in thin.parts if part.verdict != "cannot be computed"]
        assert all("3 image pairs, but at least 20 are needed" in part.message for part in weighed)
        assert [part.numbers for part in thin.parts] == [part.numbers for part in whole.parts]
    two = _with_pairs([line for line in published_results() if line.name in ("RAFT", "ARFlow")], 80)
    verdicts = {observation.verdict for observation in observations(two)}
    assert verdicts <= {"too little evidence", "cannot be computed"}


def test_inconsistent_printed_cre_is_shown_beside_the_recomputed_one():
    """SAMFlow-B, OOD: EPE 8.53, clean 4.06, printed CRE 4.44."""
    assert "4.47 from the EPE (printed: 4.44)" in _part(2, "three best in CRE (OOD)").message
    assert "4.47 from the EPE (printed: 4.44)" in _part(2, "larger foundation model gives lower EPE and CRE: T").message


def test_the_factor_by_which_errors_grow_does_not_follow_the_accuracy():
    """Over the published models, CRE increases with the clean EPE, but ln(EPE / clean EPE) does not; both correlations
    are those of SciPy.
    """
    results = [line for line in published_results() if (line.benchmark, line.setting) == ("kitti-fc", "OOD")]
    families: dict[str, list[tuple[float, ...]]] = {}
    for line in results:
        if line.name not in not_discussed(published_results()):
            clean, after = line.number("epe", "clean"), line.number("epe", "average")
            family = "SAMFlow" if "SAMFlow" in line.name else line.name
            families.setdefault(family, []).append((clean, after - clean, math.log(after / clean)))
    clean, cre, ratio = np.array([np.mean(values, axis=0) for values in families.values()]).T
    numbers = _part(1, "not only CRE but also the factor by which errors grow rises with clean EPE (OOD)").numbers
    assert numbers["ratio"] == pytest.approx(spearmanr(clean, ratio).statistic)
    assert numbers["cre"] == pytest.approx(spearmanr(clean, cre).statistic)
    assert _part(1, "CRE grows with clean EPE (OOD)").numbers["rho"] == pytest.approx(numbers["cre"])
    assert numbers["ratio"] < 0.1 < 0.55 < numbers["cre"]
