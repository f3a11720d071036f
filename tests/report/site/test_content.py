"""Check which results a page shows together and which it keeps apart."""

from __future__ import annotations

import math
import re
import sys

import polars as pl
import pytest

from robustflow.api import evaluate
from robustflow.core.errors import DataError, UsageError
from robustflow.report.site.content import run_content, whole_content
from robustflow.report.site.headline import headline
from robustflow.report.site.models import model_pages
from robustflow.run.run import Run
from robustflow.run.staleness import CACHED_VALUES_FILE
from robustflow.stats.results_file import parse_results, results_csv
from robustflow.stats.uncertainty import intervals
from robustflow.testing import ConstantFlow

_HEAD = "setting,model,metric,corruption,value,sample_set\n"


def _file(text: str):
    return parse_results(_HEAD + text, "mine.csv", "file")


def test_runs_files_and_the_paper_are_separate_groups(small_run):
    one, two = _file("OOD,A,epe,average,1.00,\n"), _file("OOD,A,epe,average,2.00,\n")
    content = whole_content([small_run], [("one.csv", one), ("two.csv", two)])
    boards = {board.benchmark: board for board in content.boards}
    titles = [section.title for section in boards["kitti-fc"].sections]
    assert titles == ["Published values", "Claimed: one.csv", "Claimed: two.csv"]
    assert "1 pair of the demo" in boards["demo"].sections[0].title
    assert boards["demo"].settings == (("knowledge", "knowledge-driven", "is not a learned method"),)


def test_results_file_written_by_a_leaderboard_stays_apart_from_other_files():
    """The leaderboard names the sample set of a file that names none; no other file gets the same name."""
    (written,) = whole_content([], [("a.csv", _file("OOD,A,epe,average,1.00,\n"))], published=False).lines
    again = parse_results(results_csv([written]), "results.csv", "file")
    content = whole_content(
        [], [("b.csv", _file("OOD,B,epe,average,2.00,\n")), ("results.csv", again)], published=False
    )
    (board,) = content.boards
    assert [[line.label for line in section.lines] for section in board.sections] == [["B"], ["A"]]


def test_measured_groups_come_before_published_ones(small_run, many_images):
    """Benchmarks are ordered by their number of runs, and those without runs by their number of models."""

    def order(*runs):
        return [board.benchmark for board in whole_content(runs).boards]

    assert order(small_run) == ["demo", "kitti-fc", "gopro-fc"]
    assert order(small_run, many_images("A"), many_images("Bb")) == ["kitti-fc", "demo", "gopro-fc"]


def test_a_value_given_twice_is_refused():
    results = _file("OOD,RAFT,epe,clean,1.00,mine\n")
    with pytest.raises(DataError, match=r"epe of 'RAFT' \(OOD\) on clean appears twice for the sample set 'mine'"):
        whole_content([], [("one.csv", results), ("two.csv", results)])


def test_a_run_has_intervals_and_a_sentence_about_them(many_images):
    content = whole_content([many_images("A"), many_images("Bb", 1.5)], published=False)
    for line, cells in content.cells.items():
        low, high = line.intervals["cre", "average"]
        assert low < line.number("cre", "average") < high
        assert cells["cre", "average"].interval == f"[{low:.2f}, {high:.2f}]"
    best = headline(content)
    assert "the most robust is A (EPE " in best[0]
    assert best[1].endswith(": A is more accurate.")
    assert "clean EPE" in best[0]
    assert "p < 0.001" in best[1]


def test_excluded_model_is_not_named_as_the_best(many_images, monkeypatch):
    """A model no better than zero flow is not named the best, although it has the lowest CRE because its error can
    hardly increase."""
    useless, sound = many_images("Blind", 1.0, seed=3), many_images("Sound", 1.5)
    rows = useless.rows.with_columns(magnitude_sum=pl.col("n_valid") * 0.001, rcre_all_sum=pl.lit(0.0))
    monkeypatch.setitem(useless.__dict__, "rows", rows)
    texts = headline(whole_content([useless, sound], published=False))
    assert not any("Blind has the lowest" in sentence or "for Blind" in sentence for sentence in texts)
    assert texts[0].startswith("Sound on ")
    (reason,) = (sentence for sentence in texts if sentence.startswith("Not ranked: Blind, because"))
    assert "of zero flow" in reason
    assert "hardly depends on the frames" in reason


def test_comparison_of_the_best_two_of_many_corrects_for_the_selection(many_images):
    runs = [many_images("A" * (1 + index), 1 + 0.1 * index) for index in range(4)]
    texts = headline(whole_content(runs, published=False))
    assert "The average EPE of A is lower than that of AA" in texts[1]
    assert "corrected for 6 comparisons" in texts[1]


def test_equal_models_have_no_winner(many_images):
    """Models with equal errors share the lead; neither wins because of its name."""
    texts = headline(whole_content([many_images("A"), many_images("Bb")], published=False))
    assert len(texts) == 1
    assert "A and Bb share the lowest EPE under corruption (" in texts[0]
    texts = headline(whole_content([many_images(name) for name in ("A", "Bb", "Ccc")], published=False))
    assert "A, Bb and Ccc share the lowest EPE under corruption (" in texts[0]
    texts = headline(whole_content([many_images("A"), many_images("Bb", 1.22, seed=1)], published=False))
    assert re.search(r"none can be called the most robust: the lead of .* \(EPE .*\) may be due to chance", texts[0])
    assert "No difference in average EPE between " in texts[1]


def test_headline_of_a_lower_corrupted_but_higher_clean_error_names_no_winner(many_images):
    """The first model has the lower error under corruption, and twice the second's error on the clean frames."""
    first, second = many_images("A"), many_images("Bb", 2.0)
    clean = pl.col("corruption") == "clean"
    doubled = [pl.when(clean).then(2 * pl.col("epe_sum")).otherwise("epe_sum").alias("epe_sum")]
    doubled += [pl.col(name) * 2 for name in first.rows.columns if name.startswith("clean_epe_sum")]
    first.rows = first.rows.with_columns(doubled)
    sentence = headline(whole_content([first, second], published=False))[0]
    assert "none can be called the most robust: A (EPE " in sentence
    assert "and Bb (EPE " in sentence


@pytest.mark.parametrize(("factor", "says"), [(1.5, "raises the end-point error from"), (0.1, "lowers the end-point")])
def test_corruption_does_not_always_raise_the_error(many_images, factor, says):
    assert says in headline(whole_content([many_images("A", factor)], published=False))[0]


def test_single_run_has_no_comparison(many_images, small_run):
    texts = headline(whole_content([many_images("A")], published=False))
    assert len(texts) == 1
    assert "px: significant" in texts[0]
    assert "too few images" in headline(run_content(small_run))[0]


def test_published_rows_have_no_significance():
    text = " ".join(headline(whole_content([])))
    assert "SAMFlow-H (OOD, EPE 8.39 px)" in text
    assert "FlowFormer (OOD, RCRE 1.29 px)" in text
    assert "the significance of a lead is unknown" in text


def test_a_page_about_a_run_leaves_the_paper_in_the_background(small_run):
    content = run_content(small_run)
    assert {line.frames for line in content.focus} == {content.lines[0].frames}
    assert len(content.lines) == 1 + 29 + 11


class Blind(ConstantFlow):
    """A model that never predicts a finite flow."""

    def __init__(self):
        super().__init__(math.nan, math.nan)

    def identity(self):
        return {"name": "blind"}


def test_run_without_any_mean_still_has_its_page(tmp_path, real_pictures):
    options = {"corruptions": ["contrast"], "severities": [1], "allow_invalid": True}
    with real_pictures():
        run = evaluate(Blind(), "demo", output=tmp_path, **options)
    content = run_content(run)
    board = content.boards[0]
    assert (board.benchmark, [column.label for column in board.columns]) == ("demo", ["Coverage"])
    assert [(line.label, [cell.text for cell in line.cells]) for line in board.lines] == [("blind", ["0.00"])]
    text = (run.path / "report.html").read_text()
    assert "predicted pixels were NaN or infinite" in text
    assert 'id="primary" data-page="blind"' in text


def test_page_without_results_says_so():
    with pytest.raises(UsageError, match="nothing to show"):
        whole_content([], [("empty.csv", _file(""))], published=False)


@pytest.mark.parametrize(
    ("metric", "values", "says"),
    [
        ("cre", (1, 3), "CRE, the worst corruption is Fog (+3.00 px); the mildest is Contrast (+1.00 px)."),
        ("rcre", (1, 3, 2), "corruptions are Fog (3.00 px), Snow (2.00 px); the mildest is Contrast (1.00 px)."),
    ],
)
def test_mildest_corruption_is_not_listed_as_one_of_the_worst(metric, values, says):
    lines = "".join(
        f"OOD,A,{metric},{name},{value}.00,\n"
        for name, value in zip(("contrast", "fog", "snow"), values, strict=len(values) == 3)
    )
    (page,) = model_pages(whole_content([], [("mine.csv", _file(lines))], published=False), {})
    assert page.sentences[0].endswith(says)


def test_the_page_of_a_model_shows_corruptions_that_the_paper_does_not_have():
    errors = {"fog": 2, "brightness": 9, "elastic_transform": 1, "average": 4}
    lines = "".join(f"OOD,A,rcre,{name},{value}.00,\n" for name, value in errors.items())
    (page,) = model_pages(whole_content([], [("flowbench.csv", _file(lines))], published=False), {})
    assert page.sentences[0].endswith(
        "Brightness (9.00 px), Fog (2.00 px); the mildest is Elastic transform (1.00 px)."
    )
    cells = {line.label: [cell.text for cell in line.cells] for line in page.tables[0].lines}
    assert cells == {"Fog": ["2.00"], "Brightness": ["9.00"], "Elastic transform": ["1.00"], "Average": ["4.00"]}
    assert page.tables[0].columns[0].strongest == 9.0


def test_many_runs_have_intervals_of_averages_only_and_release_their_rows(tmp_path, monkeypatch):
    chosen = {"corruptions": ["contrast"], "severities": [1]}
    folders = [evaluate("dis", "demo", output=tmp_path / f"{seed}", seed=seed, **chosen).path for seed in (0, 1)]
    for folder in folders:
        (folder / CACHED_VALUES_FILE).unlink(missing_ok=True)
    asked = []
    intervals_module = sys.modules[intervals.__module__]

    def counted(rows, *, corruptions, families):
        asked.append(corruptions)
        return intervals(rows, corruptions=corruptions, families=families)

    monkeypatch.setattr(intervals_module, "intervals", counted)
    monkeypatch.setattr("robustflow.report.site.content.MOST_DETAILED", 1)
    runs = [Run(folder) for folder in folders]
    whole_content(runs, published=False)
    assert asked == [False, False]
    assert all("rows" not in vars(run) for run in runs)
    monkeypatch.setattr("robustflow.report.site.content.MOST_DETAILED", 2)
    content = whole_content([Run(folder) for folder in folders], published=False)
    assert asked == [False, False]
    assert not any(line.intervals for line in content.lines)  # a single pair has no intervals
    assert asked == [False, False, True, True]


def test_intervals_of_averages_alone_equal_those_computed_with_all(structured_rows):
    whole = intervals(structured_rows)
    few = intervals(structured_rows, corruptions=False)
    averages = whole.filter(pl.col("corruption").is_in(["average", "clean"]))
    assert few.height == 5
    assert few.drop("standard_error", "low", "high").equals(averages.drop("standard_error", "low", "high"))
    for name in ("standard_error", "low", "high"):
        assert few[name].to_list() == pytest.approx(averages[name].to_list(), rel=1e-12)


@pytest.fixture(scope="module")
def structured_rows(small_run):
    """Ten pairs with different errors."""
    rows = small_run.rows
    totals = [name for name in rows.columns if "epe_sum" in name or ("rcre" in name and "sum" in name)]
    return pl.concat(
        rows.with_columns(
            pl.lit(f"pair {index}").alias("sample"),
            pl.lit(f"pair {index}").alias("group"),
            *(pl.col(name) * (1 + 0.1 * index) for name in totals),
        )
        for index in range(10)
    )


def test_the_interval_of_a_family_is_that_of_its_only_corruption(structured_rows):
    """Contrast is the only digital corruption here, and fog the only weather corruption; families without any
    corruption have no interval.
    """
    made = intervals(structured_rows, families=True)
    for family, corruption in (("digital", "contrast"), ("weather", "fog")):
        for metric in ("epe", "cre", "crer", "rcre"):
            of_family, of_one = (made.filter(metric=metric, corruption=name) for name in (family, corruption))
            assert of_family["estimate"].to_list() == pytest.approx(of_one["estimate"].to_list())
            assert of_family["low"].to_list() == pytest.approx(of_one["low"].to_list())
    assert made.filter(corruption="noise").is_empty()
