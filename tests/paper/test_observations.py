"""The observations are checked on the published data, and on changed data with known verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from statistics import fmean

import numpy as np
import pytest
from scipy.stats import binomtest, spearmanr, ttest_1samp, ttest_ind

from robustflow.corruptions.registry import FAMILIES
from robustflow.paper.evidence import Evidence
from robustflow.paper.margin import of_correlation, of_difference, of_majority, of_mean
from robustflow.paper.observations import observations
from robustflow.stats.lines import CRER, FLOPS, LineKey, Lines, Numbers
from robustflow.stats.published.tables import not_discussed, published_lines

_PUBLISHED = {o.number: o for o in observations(published_lines())}


def _part(number: int, words: str):
    return next(part for part in _PUBLISHED[number].parts if words in part.claim)


def test_published_data_give_the_stated_verdicts():
    """As printed, every observation is true; five do not generalise. Two verdicts are of different things."""
    assert all(observation.printed for observation in _PUBLISHED.values())
    verdicts = {number: observation.generalises for number, observation in _PUBLISHED.items()}
    assert verdicts == dict.fromkeys((3, 4, 6, 7, 8), "yes") | dict.fromkeys((1, 2, 5, 9, 10), "too little evidence")


@pytest.mark.parametrize(
    ("number", "words", "printed", "generalises"),
    [
        (1, "CRE grows with clean EPE (ID)", True, "too little evidence"),
        (1, "corrupted EPE grows with clean EPE (OOD)", True, "yes"),
        (2, "lower CRE: T > B > H (OOD)", False, "too little evidence"),
        (2, "lower CRE: T > B > H (ID)", True, "too little evidence"),
        (3, "than most supervised", False, "too little evidence"),
        (3, "lowest CREr", True, "too little evidence"),
        (4, "for all models", True, "yes"),
        (5, "291 %", False, None),
        (6, "ARFlow ranks first", True, None),
        (6, "CSFlow ranks highest", True, None),
        (7, "low_light has a higher EPE than high_light, for all", False, "yes"),
        (8, "saturate has a lower EPE than jpeg_compression, for all", True, "yes"),
        (9, "under most corruptions", True, "too little evidence"),
        (10, "than most CNN", True, "too little evidence"),
    ],
)
def test_statement_is_judged_as_printed_and_in_general(number, words, printed, generalises):
    part = _part(number, words)
    assert (part.printed, part.margin and part.margin.verdict) == (printed, generalises)


def test_correlation_is_over_models_as_printed_and_over_families_in_general():
    """CRE against clean EPE in ID: Spearman +0.18 over 14 models, of which three are SAMFlow's sizes."""
    part = _part(1, "CRE grows with clean EPE (ID)")
    assert part.margin.low < 0 < part.margin.high
    assert (part.margin.over, part.numbers["models"]) == ("over 12 families", 14)
    assert part.numbers["Spearman"] == pytest.approx(0.18, abs=0.005)


def test_verdicts_are_those_of_intervals_that_scipy_gives():
    evidence = Evidence(published_lines())

    def families(setting, kind, value):
        members: dict[str, list[float]] = {}
        for entry in evidence.discussed(setting, kind):
            members.setdefault("SAMFlow" if "SAMFlow" in entry[1] else entry[1], []).append(value(entry))
        return {name: fmean(values) for name, values in members.items()}

    ood, in_domain = (families(setting, "supervised", evidence.crer) for setting in ("OOD", "ID"))
    rises = [in_domain[name] - ood[name] for name in ood]
    low, high = ttest_1samp(rises, 0).confidence_interval()
    assert f"{fmean(rises):+.2f} [{low:+.2f}, {high:+.2f}] over 9 families" == str(_part(4, "on average over").margin)
    without = list(families("ID", "unsupervised", evidence.crer).values())
    low, high = ttest_ind(list(in_domain.values()), without, equal_var=False).confidence_interval()
    assert f"[{low:+.2f}, {high:+.2f}] over 9 and 3 families" in str(_part(3, "lower CREr").margin)
    exact = binomtest(13, 24).proportion_ci(method="exact")
    assert exact.low < 0.5 < exact.high


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


def test_sizes_of_one_method_are_one_family():
    evidence = Evidence(published_lines())
    assert len(evidence.by_family([("OOD", f"SAMFlow-{size}") for size in "TBH"], evidence.epe)) == 1


def test_observations_state_numbers_read_off_the_tables_by_hand():
    dark = _part(7, "low_light has a higher EPE than high_light, for all").numbers
    assert (dark["exceptions"], dark["models"]) == (3, 29)
    assert {name for name, value in dark.items() if value <= 0} == {"ID GMA", "ID SKFlow", "ID CRAFT"}
    stable = _part(3, "lower CREr").numbers
    assert stable["highest unsupervised"] == pytest.approx((7.33 - 3.52) / 3.52)
    assert stable["lowest supervised"] == pytest.approx((9.13 - 3.67) / 3.67)
    noise = _part(5, "291 %").numbers["noise"]
    ood = ((10.82 + 9.75 + 10.95) / 3 - 4.11) / 4.11
    in_domain = ((11.31 + 8.51 + 12.96) / 3 - 1.96) / 1.96
    assert noise == pytest.approx(100 * (in_domain / ood - 1))
    assert _part(9, "under most corruptions").numbers == {"lowest": 13, "corruptions": 24}
    assert _part(10, "than most CNN").numbers["median of CNN-based models"] == 1.53


def _verdicts(results: Lines) -> dict[int, tuple[bool, str]]:
    return {o.number: (o.printed, o.generalises) for o in observations(results)}


def test_observations_are_numbered_in_the_papers_order():
    assert list(_PUBLISHED) == list(range(1, 11))


_PARTNER = {"low_light": "high_light", "over_exposure": "under_exposure"}
_PARTNER |= {milder: worse for worse, milder in _PARTNER.items()}
_MILD = ("contrast", "saturate", "fog")


Change = Callable[[LineKey, Numbers], Numbers]


def _everywhere(line: Numbers, change: Callable[[str, float], float]) -> Numbers:
    """Change the number of every EPE and RCRE under a corruption."""
    return Numbers(
        (of, row if of[0] == "cre" or of[1] == "clean" else row | {"value": change(of[1], row["value"])})
        for of, row in line.items()
    )


def _follows(sign: int) -> Change:
    """Return a change after which the average EPE rises or falls with the clean EPE."""

    def change(_, line):
        clean, of = line.number("epe", "clean"), ("epe", "average", None)
        return Numbers(line | {of: line[of] | {"value": 30 + 3 * sign * clean}}) if of in line else line

    return change


def _of(names: Collection[str], change: Callable[[str, float], float]) -> Change:
    return lambda key, line: _everywhere(line, change) if key.model in names else line


def _exposures_exchanged(_, line):
    numbers = line.by_corruption("epe")
    return _everywhere(line, lambda name, number: numbers.get(_PARTNER.get(name), number))


def _worse_before_training(key, line):
    return _everywhere(line, lambda _, number: 9 * number if key.setting == "OOD" else number)


def _mild_weather_after_training(key, line):
    mild = key.setting == "ID"
    return _everywhere(line, lambda name, number: 0.0 if mild and name in FAMILIES["weather"] else number)


@pytest.mark.parametrize(
    ("number", "change", "verdict"),
    [
        (1, _follows(1), (True, "yes")),
        (1, _follows(-1), (False, "no")),
        (2, _of(("CSFlow",), lambda _, number: number + 50), (False, "no")),
        (3, _of(("ARFlow", "UPFlow", "BrightFlow"), lambda _, number: 9 * number), (False, "no")),
        (4, _worse_before_training, (False, "no")),
        (5, _mild_weather_after_training, (False, "no")),
        (7, _exposures_exchanged, (False, "no")),
        (8, lambda _, line: _everywhere(line, lambda name, number: number + 99 * (name in _MILD)), (False, "no")),
        (9, _of(("FlowFormer",), lambda _, number: number + 5), (False, "no")),
        (10, _of(("SAMFlow-H", "SAMFlow-B", "SAMFlow-T"), lambda _, number: number - 1), (False, "no")),
    ],
)
def test_verdict_follows_from_changed_numbers(number, change, verdict):
    assert _verdicts({key: change(key, line) for key, line in published_lines().items()})[number] == verdict


def _with_worst_cost(*names: str) -> Lines:
    """Return the published results, changed so that the given models have the highest FLOPs and CREr."""
    lines = {}
    for key, line in published_lines().items():
        worst = {FLOPS: 9e4, CRER: 99.0} if FLOPS in line and key.model in names else {}
        lines[key] = Numbers(line | {of: line[FLOPS] | {"value": value} for of, value in worst.items()})
    return lines


@pytest.mark.filterwarnings("ignore:Precision loss")  # all ranks of a group are equal
def test_observation_about_cost_reverses_with_the_costs():
    assert _verdicts(_with_worst_cost("ARFlow"))[6] == (False, "too little evidence"), (
        "one of three unsupervised is last"
    )
    assert _verdicts(_with_worst_cost("ARFlow", "UPFlow", "BrightFlow"))[6] == (False, "no")


def test_the_factor_by_which_errors_grow_does_not_follow_the_accuracy():
    """Over the published models, CRE increases with the clean EPE, but ln(EPE / clean EPE) does not; both correlations
    are those of SciPy.
    """
    families: dict[str, list[tuple[float, ...]]] = {}
    for key, line in published_lines().items():
        of_discussed = key.model not in not_discussed(published_lines())
        if of_discussed and (key.benchmark, key.setting) == ("kitti-fc", "OOD"):
            clean, after = line.number("epe", "clean"), line.number("epe", "average")
            family = "SAMFlow" if "SAMFlow" in key.model else key.model
            families.setdefault(family, []).append((clean, after - clean, math.log(after / clean)))
    clean, cre, ratio = np.array([np.mean(values, axis=0) for values in families.values()]).T
    of_cre = _part(1, "CRE grows with clean EPE (OOD)").margin.estimate
    of_ratio = _part(1, "ln(EPE / clean EPE) grows with clean EPE (OOD)").margin.estimate
    assert of_ratio == pytest.approx(spearmanr(clean, ratio).statistic)
    assert of_cre == pytest.approx(spearmanr(clean, cre).statistic)
    assert of_ratio < 0.1 < 0.55 < of_cre
