"""Corrupted benchmarks are written as files, resumed, and read back with the same rows."""

import shutil
from dataclasses import replace

import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, RunError, UsageError
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.benchmarks.export import export
from robustflow.data.benchmarks.setting import setting_of
from robustflow.models import ModelRef
from robustflow.models.provenance import Training
from robustflow.report.site.content import run_content
from robustflow.report.site.models import model_pages
from robustflow.stats.notes import comparison_note
from tests.data.datasets.layouts import picture
from tests.made_rows import made_run
from tests.refusals import refusal

DIS = ModelRef.parse("dis", {"preset": "ultrafast"})


class Fade:
    """A user's corruption that divides the brightness."""

    def __init__(self, by):
        self.by = by

    def draw(self, rng, severity, shape):
        return self.by * severity

    def apply(self, frame, state, index):
        return frame // state


@pytest.fixture
def one(kitti):
    return load_benchmark("kitti-fc", kitti).narrowed(["contrast"], [1], 1)


def test_an_export_reads_back_to_the_same_rows(kitti, tmp_path):
    chosen = ["high_light", "impulse_noise", "elastic_transform"]
    benchmark = load_benchmark("kitti-fc", kitti).narrowed(chosen, [1, 4], 2)
    written = list(export(benchmark, tmp_path / "fc", seed=5))
    assert len(written) == 2 * (1 + 3 * 2)
    assert all(step.fresh for step in written)
    assert (tmp_path / "fc" / "brightness_4" / "val" / "image_2" / "000001_11.png").is_file()

    released = rf.evaluate(DIS, "kitti-fc", tmp_path / "fc", tmp_path / "released")
    direct = rf.evaluate(DIS, benchmark, output=tmp_path / "direct", seed=5)
    assert released.rows.equals(direct.rows)
    occluded = released.rows.filter(pl.col("corruption") == "clean", pl.col("n_occ") > 0)
    assert occluded.height == 2
    assert released.mean("epe_clean", "occ") == (occluded["epe_sum_occ"] / occluded["n_occ"]).mean()

    (tmp_path / "fc" / "export.json").unlink()  # as in the authors' release, which has only the paper's corruptions
    with pytest.warns(UserWarning, match="78 of KITTI-FC's 80 pairs"):
        assert set(load_benchmark("kitti-fc", tmp_path / "fc").corruptions) == {"high_light", "impulse_noise"}


def test_an_export_is_not_mistaken_for_the_frames_that_the_authors_released(kitti, tmp_path):
    direct = load_benchmark("kitti-fc", kitti).narrowed(["contrast"], [1], 2)
    list(export(direct, tmp_path / "fc", seed=5, severity_scale="calibrated"))
    run = rf.evaluate(DIS, "kitti-fc", tmp_path / "fc", tmp_path / "run")
    eighty = made_run(
        run, pl.concat(run.rows.with_columns(sample=pl.col("sample") + f" copy {number}") for number in range(40))
    )
    assert comparison_note(eighty).startswith("80 pairs, not the paper's 80; ")
    assert comparison_note(eighty).endswith("; calibrated severities, not the paper's")
    protocol = run.manifest.identity.frames.protocol
    made = run.manifest.identity.frames.made_with
    assert (made["seed"], made["variant"], made["severity_scale"][:10]) == (5, "default", "calibrated")
    (_, tables), *_ = model_pages(run_content(run)).values()
    facts = {line.label: line.cells[0].text for line in tables[-1].lines}
    assert (facts["Seed"], facts["Severity scale"][:10]) == ("5", "calibrated")
    trained = Training(sets=("kitti2015:train",), basis="declared")
    assert setting_of(trained, "kitti-fc", direct.keys, protocol) == setting_of(trained, "kitti-fc", direct.keys)


def test_a_part_of_the_released_gopro_fc_is_marked_beside_the_published_rows(tmp_path):
    """The paper's appendix states 135 pairs for each of five sequences."""
    for folder in ("clean", "contrast_1"):
        for number in (0, 1):
            picture(tmp_path / "fc" / folder / "GOPR0374_11_02" / f"000032_{number}.png", 48, 64)
    with pytest.warns(UserWarning, match="4 .*GoPro-FC.* 5"):
        run = rf.evaluate(DIS, "gopro-fc", tmp_path / "fc", tmp_path / "run")
    assert comparison_note(run).startswith("1 pair, not the paper's 675; ")
    copies = pl.concat(run.rows.with_columns(sample=pl.col("sample") + f" copy {number}") for number in range(675))
    assert "pair" not in comparison_note(made_run(run, copies))


def test_an_export_continues_and_never_mixes(one, tmp_path):
    list(export(one, tmp_path))
    frame = tmp_path / "contrast_1" / "val" / "image_2" / "000001_11.png"
    before = frame.read_bytes()
    frame.unlink()
    assert [step.fresh for step in export(one, tmp_path)] == [False, True]
    assert frame.read_bytes() == before
    refusal(lambda: list(export(one, tmp_path, seed=1)), RunError, tmp_path)
    (tmp_path / "export.json").write_text("[" * 100_000)
    refusal(lambda: list(export(one, tmp_path)), RunError, tmp_path)
    (tmp_path / "export.json").unlink()  # frames of others would be kept and called an export
    refusal(lambda: list(export(one, tmp_path)), RunError, tmp_path)
    assert load_benchmark("kitti-fc", tmp_path).protocol == {"frames": "released"}


@pytest.mark.parametrize(("clip", "by"), [("second", 2), ("first", 3)])
def test_an_export_of_a_different_clip_or_an_edited_corruption_is_refused_before_it_writes(tmp_path, clip, by):
    for name in ("first", "second"):
        for index in range(4):
            picture(tmp_path / name / f"{index}.png")
    output = tmp_path / "out"
    list(export(load_benchmark("folder", tmp_path / "first").narrowed([Fade(2)], [1], 1), output))
    before = {path: path.read_bytes() for path in output.rglob("*.png")}
    other = load_benchmark("folder", tmp_path / clip).narrowed([Fade(by)], [1])
    refusal(lambda: list(export(other, output)), RunError, output)
    assert {path: path.read_bytes() for path in output.rglob("*.png")} == before


def test_frames_exported_from_a_different_benchmark_are_not_called_kitti_fc(tmp_path):
    shapes = load_benchmark("shapes", options={"pairs": 1, "size": "32x48"})
    list(export(shapes.narrowed(["contrast"], [1]), tmp_path))
    refusal(lambda: load_benchmark("kitti-fc", tmp_path), DataError, tmp_path)


def test_occluded_and_non_occluded_ground_truth_are_two_exports(kitti, tmp_path):
    noc = shutil.copytree(kitti, tmp_path / "noc", ignore=shutil.ignore_patterns("flow_occ"))
    list(export(load_benchmark("kitti2015", noc).narrowed(["contrast"], [1], 1), tmp_path / "out"))
    occ = load_benchmark("kitti2015", kitti).narrowed(["contrast"], [1], 1)
    refusal(lambda: list(export(occ, tmp_path / "out")), RunError, tmp_path / "out")


def test_export_with_keys_that_are_no_file_names_leaves_no_folder(one, tmp_path):
    refusal(lambda: list(export(replace(one, keys=("a/0",)), tmp_path / "fc")), DataError, "a/0")
    assert not (tmp_path / "fc").exists()


def test_released_folder_has_only_the_conditions_that_it_contains(kitti, tmp_path):
    list(export(load_benchmark("kitti-fc", kitti).narrowed(["contrast"], [1, 3], 1), tmp_path / "fc"))
    released = load_benchmark("kitti-fc", tmp_path / "fc")
    assert (released.corruptions, released.severities) == (("contrast",), (1, 3))
    assert released.dataset.name == "kitti_fc_released"
    refusal(lambda: load_benchmark("kitti_fc_released", tmp_path / "fc"), UsageError, "kitti_fc_released")
    refusal(lambda: released.narrowed(["fog"]), UsageError, "kitti-fc")
    for severity in (1, 3):
        (tmp_path / "fc" / f"contrast_{severity}").rename(tmp_path / f"moved_{severity}")
    refusal(lambda: load_benchmark("kitti-fc", tmp_path / "fc"), DataError, tmp_path / "fc")
