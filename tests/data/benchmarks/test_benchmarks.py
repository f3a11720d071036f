"""Test the samples and corruptions of benchmarks, and that exported benchmarks can be read back."""

import shutil
import sys
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau
from typer.testing import CliRunner

import robustflow as rf
from robustflow.cli.main import app
from robustflow.cli.tables import print_result
from robustflow.core.errors import DataError, UsageError
from robustflow.corruptions.registry import FAMILIES, FURTHER, IMAGE_PAIR
from robustflow.data.benchmarks import benchmark_facts, load_benchmark
from robustflow.data.benchmarks.benchmark import spread
from robustflow.data.benchmarks.facts import BenchmarkFacts, QuickSubset, estimate_remark
from robustflow.data.datasets.split import kitti_split
from robustflow.report.render import render
from robustflow.report.tables import tables_of
from robustflow.run.comparable import sample_set
from robustflow.run.records.pack import pack
from robustflow.stats.notes import comparison_note
from robustflow.stats.published.tables import published_lines
from robustflow.testing import ZeroFlow
from tests.data.datasets.layouts import picture
from tests.made_rows import made_run, rows_frame
from tests.refusals import refusal


def test_kitti_fc_has_twenty_corruptions_and_all_of_few_pairs_or_those_of_a_split(kitti, tmp_path):
    benchmark = load_benchmark("kitti-fc", kitti)
    assert len(benchmark.corruptions) == 20
    assert benchmark.keys == ("000000", "000001", "000002")
    (tmp_path / "split.txt").write_text("000002\n")
    assert load_benchmark("kitti-fc", kitti, tmp_path / "split.txt").keys == ("000002",)


@pytest.mark.parametrize(
    ("asked", "chosen"),
    [
        ("all", IMAGE_PAIR),
        ("weather", FAMILIES["weather"]),
        (["fog", "weather", "noise"], ["fog", "spatter", "frost", "snow", *FAMILIES["noise"]]),
        ("blur", [name for name in FAMILIES["blur"] if name != "object_motion_blur"]),
        ("sensor", ["raw_noise"]),
        ("depth", FURTHER["depth"]),
        (["noise:2+fog"], None),
        ("video", None),
    ],
)
def test_family_names_select_corruptions_that_the_benchmark_can_make(asked, chosen):
    demo = load_benchmark("demo")
    if chosen is None:
        with pytest.raises(UsageError):
            demo.narrowed(asked)
    else:
        assert demo.narrowed(asked).corruptions == tuple(chosen)


@pytest.fixture
def only_noc(kitti, tmp_path):
    """A folder with the same pairs, but only with `flow_noc/`."""
    shutil.copytree(kitti, tmp_path / "noc", ignore=shutil.ignore_patterns("flow_occ"))
    return tmp_path / "noc"


def test_without_flow_occ_kitti_fc_is_refused_and_kitti2015_warns(only_noc, tmp_path):
    refusal(lambda: load_benchmark("kitti-fc", only_noc), DataError, only_noc / "training")
    with pytest.warns(UserWarning, match=str(only_noc)):
        load_benchmark("kitti2015", only_noc)
    (tmp_path / "released" / "clean").mkdir(parents=True)
    (only_noc / "training").rename(tmp_path / "released" / "clean" / "val")
    folder = tmp_path / "released"
    refusal(lambda: load_benchmark("kitti-fc", folder), DataError, folder / "clean" / "val")


def test_results_over_non_occluded_ground_truth_are_marked_everywhere(kitti, only_noc, tmp_path, real_pictures):
    few = {"corruptions": ["contrast"], "severities": [1]}
    with real_pictures():
        noc = rf.evaluate("dis", "kitti2015", only_noc, tmp_path / "noc_run", **few)
        occ = rf.evaluate("dis", "kitti2015", kitti, tmp_path / "occ_run", **few)
    words = "non-occluded ground truth"
    assert noc.manifest.identity.frames.protocol == {"ground_truth": "non-occluded"}
    assert occ.manifest.identity.frames.protocol == {}
    assert sample_set(noc) != sample_set(occ)
    assert words in comparison_note(noc)
    pages = {run: (run.path / "report.html").read_text() for run in (noc, occ)}
    shown = {run: CliRunner().invoke(app, ["report", str(run.path)]).output for run in (noc, occ)}
    tables = {run: render(tables_of([run], published=False, wanted=["epe"])[0], "latex") for run in (noc, occ)}
    packed = {run: pack(run, tmp_path / f"{run.path.name}.robustflow") for run in (noc, occ)}
    verified = {run: CliRunner().invoke(app, ["record", "verify", str(path)]).output for run, path in packed.items()}
    for texts in (pages, shown, tables, verified, {noc: str(noc), occ: str(occ)}):
        assert words in texts[noc]
        assert words not in texts[occ]


def _named_like_kitti(root, keys):
    """Empty files with KITTI 2015's file names; opening the benchmark reads only the names."""
    for folder, frames in (("image_2", ("10", "11")), ("flow_occ", ("10",))):
        (root / "training" / folder).mkdir(parents=True)
        for key in keys:
            for frame in frames:
                (root / "training" / folder / f"{key}_{frame}.png").touch()
    return root


ALL = [f"{number:06d}" for number in range(200)]
THE_80 = list(kitti_split(ALL).evaluation)
OTHERS = [key for key in ALL if key not in THE_80]


@pytest.mark.parametrize(
    ("keys", "numbers"),
    [
        (THE_80[3:], ["3 of", THE_80[0], THE_80[2]]),
        (OTHERS[:2] + THE_80[:1], ["79 of", "2 of the 3", THE_80[20], "59 more"]),
        ([key for key in ALL if key != OTHERS[0]], ["119 of the 199"]),
    ],
)
def test_a_part_of_kitti_fc_says_what_is_missing(tmp_path, recwarn, keys, numbers):
    assert load_benchmark("kitti-fc", _named_like_kitti(tmp_path, keys)).keys == tuple(sorted(keys))
    (warning,) = recwarn.list
    assert all(number in str(warning.message) for number in numbers)


def test_complete_kitti_fc_and_gopro_fc_are_opened_without_a_note(tmp_path, recwarn):
    assert load_benchmark("kitti-fc", _named_like_kitti(tmp_path / "kitti", ALL)).keys == tuple(THE_80)
    for folder in ("clean", "contrast_1"):
        for sequence in ("374_11_02", "379_11_00", "384_11_02", "385_11_00", "386_11_00"):
            for index in (0, 1):
                picture(tmp_path / "gopro" / folder / f"GOPR0{sequence}" / f"000032_{index}.png", 8, 8)
    assert len(load_benchmark("gopro-fc", tmp_path / "gopro").keys) == 5
    assert not [one.message for one in recwarn if one.category is not ResourceWarning]


def test_narrowed_benchmark_has_the_requested_corruptions_severities_and_pairs(kitti):
    benchmark = load_benchmark("kitti-fc", kitti)
    narrow = benchmark.narrowed(["snow", "fog", "snow"], [5, 1], 2)
    assert (narrow.corruptions, narrow.severities, narrow.keys) == (("snow", "fog"), (1, 5), benchmark.keys[:2])
    assert benchmark.narrowed(limit=1).keys == benchmark.keys[1:2]
    assert benchmark.narrowed(limit=9).keys == benchmark.keys
    for name, wrong in (("corruptions", ["sno"]), ("corruptions", []), ("severities", [0]), ("severities", [6])):
        with pytest.raises(UsageError):
            benchmark.narrowed(**{name: wrong})
    with pytest.raises(UsageError):
        benchmark.narrowed(limit=0)
    refusal(benchmark.still, UsageError, "--still")


@given(st.integers(1, 400), st.integers(1, 400))
def test_limit_selects_pairs_evenly_and_a_larger_limit_only_adds_pairs(count, limit):
    keys = [f"{number:06d}" for number in range(count)]
    chosen = spread(keys, limit)
    assert len(chosen) == min(count, limit)
    assert list(chosen) == sorted(set(chosen))
    assert set(spread(keys, limit - 1)) < set(chosen) or limit > count
    places = [-1, *map(int, chosen), count]
    widest = max(after - before for before, after in pairwise(places))
    assert widest <= 2 * (count / len(chosen)) + 1  # the widest gap is at most twice the mean gap


@pytest.mark.parametrize("name", ["kitti-fc", "folder"])
def test_benchmark_without_its_data_asks_for_the_data_option(name):
    refusal(lambda: load_benchmark(name), UsageError, "--data")


def test_any_dataset_is_a_benchmark(kitti, tmp_path):
    (tmp_path / "split.txt").write_text("000001\n")
    benchmark = load_benchmark("kitti2015", kitti, tmp_path / "split.txt")
    assert (benchmark.keys, len(benchmark.corruptions)) == (("000001",), 20)
    frames = load_benchmark("folder", kitti / "training" / "image_2", options={"step": 2, "pairs": "consecutive"})
    assert frames.protocol == {"options": {"pairs": "consecutive", "step": "2"}}, "a different step is a different run"
    refusal(lambda: load_benchmark("kitti-fc", kitti, options={"render_pass": "final"}), UsageError, "kitti-fc")
    refusal(lambda: load_benchmark("sintl", kitti), UsageError, "sintl")


def test_clean_errors_of_the_real_pairs_equal_a_direct_computation(shared, tmp_path):
    root = shared("data", "kitti2015")
    run = rf.evaluate("dis", "kitti-fc", root, tmp_path, corruptions=["contrast"], severities=[1])
    clean = run.rows.filter(corruption="clean")
    assert clean.height == len(list((root / "training" / "flow_occ").glob("*_10.png")))
    for key, total, count in clean.select("sample", "epe_sum", "n_valid").iter_rows():
        path = root / "training" / "flow_occ" / f"{key}_10.png"
        raw = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)[..., ::-1].astype(np.float64)
        flow, valid = (raw[..., :2] - 2**15) / 64, raw[..., 2] > 0
        images = (root / "training" / "image_2" / f"{key}_{n}.png" for n in (10, 11))
        grey = (cv2.cvtColor(cv2.imread(str(image)), cv2.COLOR_BGR2GRAY) for image in images)
        predicted = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(*grey, None)
        assert total / count == pytest.approx(np.linalg.norm(predicted - flow, axis=2)[valid].mean(), abs=1e-4)


def test_folder_of_a_different_data_set_is_refused_by_name(kitti, tmp_path):
    (tmp_path / "training" / "colored_0").mkdir(parents=True)
    for name, data, fitting in (("kitti-fc", tmp_path, "kitti2012"), ("sintel", kitti, "kitti-fc")):
        refused = refusal(lambda name=name, data=data: load_benchmark(name, data), DataError, data)
        assert str(refused).endswith(f"={fitting!r}")


def test_a_damaged_folder_of_the_dataset_itself_suggests_no_different_benchmark(kitti, tmp_path):
    damaged = shutil.copytree(kitti, tmp_path / "kitti")
    lost = damaged / "training" / "image_2" / "000000_11.png"
    lost.unlink()
    for name in ("kitti-fc", "kitti2015"):
        refused = refusal(lambda name=name: load_benchmark(name, damaged), DataError, lost)
        assert "benchmark" not in str(refused)


def test_unusable_paths_are_refused_in_one_line(tmp_path):
    archive = tmp_path / "data_scene_flow.zip"
    archive.write_bytes(b"PK")
    for path, culprit in (("x" * 5000, f"{'x' * 60}..."), ("~no_user/a", "~no_user/a"), (archive, archive)):
        refused = refusal(lambda path=path: load_benchmark("kitti-fc", path), DataError, culprit)
        assert len(str(refused)) < 400


@pytest.fixture(scope="module")
def quick_subset():
    spec = spec_from_file_location("quick_subset", Path(__file__).parents[3] / "bench/quick_subset.py")
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tau_of_the_quick_subset_is_within_a_setting_and_over_other_methods(quick_subset):
    quick = benchmark_facts("kitti-fc").quick
    lines = {key: line for key, line in published_lines().items() if key.benchmark == "kitti-fc"}
    assert len(lines) == quick.published
    taus = {"OOD": [], "ID": []}
    for (setting, found), metric in product(taus.items(), ("epe", "cre", "rcre")):
        of_setting = [line for key, line in lines.items() if key.setting == setting]
        means = [
            [np.mean([line.number(metric, name) for name in names]) for line in of_setting]
            for names in (quick.corruptions, IMAGE_PAIR)
        ]
        found.append(kendalltau(*means).statistic)
    assert min(taus["OOD"]) > min(taus["ID"]) == pytest.approx(quick.tau, abs=0.005)
    assert quick_subset.held_out(len(quick.corruptions)).mean() == pytest.approx(quick.tau_of_others, abs=0.005)


def test_means_over_the_quick_subset_are_estimates_until_more_is_measured(tmp_path):
    chosen = QuickSubset(
        corruptions=("contrast",), severities=(1, 3), tau=0.96, tau_of_others=0.9, published=8, measured=5
    )
    facts = BenchmarkFacts(title="Mine", quick=chosen)
    mine = replace(load_benchmark("shapes", options={"pairs": 1, "size": "32x48"}), facts=facts)
    quick = rf.evaluate(ZeroFlow(), mine, output=tmp_path / "run", subset="quick")
    assert quick.manifest.corruptions == ("contrast",)
    assert quick.manifest.severities == (1, 3)
    assert estimate_remark(facts, quick.manifest.corruptions, quick.manifest.severities)
    measured = sample_set(quick)
    more = rf.evaluate(ZeroFlow(), mine, output=tmp_path / "run", corruptions=["contrast", "pixelate"], severities=[1])
    assert not estimate_remark(facts, more.manifest.corruptions, more.manifest.severities)
    assert rf.load_run(tmp_path / "run").manifest.uneven
    assert sample_set(more) != measured


def test_estimated_mean_is_marked_in_the_terminal_and_in_tables(tmp_path, capsys):
    quick = benchmark_facts("kitti-fc").quick
    base = rf.evaluate(ZeroFlow(), "demo", output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    (clean,) = base.rows.filter(corruption="clean").to_dicts()
    cells = [(name, level) for name in quick.corruptions for level in quick.severities]
    rows = rows_frame([clean, *(clean | {"corruption": name, "severity": level} for name, level in cells)])
    run = made_run(base, rows, benchmark="kitti-fc")
    remark = estimate_remark(benchmark_facts("kitti-fc"), quick.corruptions, quick.severities)
    assert "29 published and 14 measured" in remark
    assert remark in comparison_note(run)
    print_result(run, report=False)
    assert remark in capsys.readouterr().out
    fewer = made_run(base, rows.filter(pl.col("corruption") != quick.corruptions[0]), benchmark="kitti-fc")
    assert remark not in comparison_note(fewer)


@pytest.mark.parametrize(
    "options", [{"subset": "quik"}, {"subset": "quick"}, {"subset": "quick", "corruptions": "fog"}]
)
def test_impossible_subset_is_refused_before_the_run_starts(tmp_path, options):
    with pytest.raises(UsageError):
        rf.evaluate("dis", "demo", output=tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()
