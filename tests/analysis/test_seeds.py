"""Test the sources of a score's variance, rankings with ties, and the order of models under different conditions."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from robustflow.analysis.conditions import seed_groups
from robustflow.analysis.uncertainty import compare_all, rank_stability, standings, variance_split
from robustflow.cli.main import app
from robustflow.cli.tables import print_results
from robustflow.errors import RunError, UsageError
from robustflow.report.assemble import tables_of
from robustflow.report.render import FORMATS, render
from robustflow.report.standings_tables import stability_table
from robustflow.runs.run import Run
from tests.made_rows import made_run

from .simulated import rows_of

IMAGES = 60


def _runs(image: float, seed: float, noise: float, seeds: int, rng: np.random.Generator) -> dict[int, pl.DataFrame]:
    """Runs with CRE = 5 + image + seed + noise; all contain fog at severities 1 and 3."""
    clean, own = np.full(IMAGES, 1.0), rng.normal(0, image, IMAGES)
    runs = {}
    for number in range(seeds):
        shift = rng.normal(0, seed)
        errors = 6 + own[:, None] + shift + rng.normal(0, noise, (IMAGES, 3))
        rows = rows_of(clean, errors, errors)
        runs[number] = rows.filter(pl.col("corruption") != "snow")
    return runs


def _of(split: pl.DataFrame, source: str, column: str = "deviation") -> float:
    return split.filter(source=source)[column].item()


def test_a_source_without_a_spread_has_none():
    rng = np.random.default_rng(1)
    splits = [variance_split(_runs(0.5, 0.0, 0.1, 3, rng), "cre") for _ in range(8)]
    for split in splits:
        assert _of(split, "image") == pytest.approx(0.5, rel=0.3)
        assert _of(split, "seed") < 0.05
        assert split["share"].sum() == pytest.approx(100)
    assert min(_of(split, "seed") for split in splits) == 0, "a negative estimate of a variance counts as 0"


def test_a_split_is_the_analysis_of_variance_in_sums_of_squares():
    runs = _runs(0.5, 0.4, 0.3, 3, np.random.default_rng(4))
    fog = [[run.filter(corruption="fog", severity=level).sort("sample")["epe_sum"].to_numpy() / 1000 - 1
            for level in (1, 3)] for run in runs.values()]  # fmt: skip
    y = np.array(fog).transpose(2, 0, 1)  # image, seed, severity
    images, seeds, levels = y.shape
    of_image, of_seed, of_level, of_cell = (
        (y.mean(axis=axes, keepdims=True) - y.mean()) * np.ones(y.shape) for axes in ((1, 2), (0, 2), (0, 1), 2)
    )
    ss_image, ss_seed, ss_level, ss_cell, ss = (
        float((part**2).sum()) for part in (of_image, of_seed, of_level, of_cell, y - y.mean())
    )
    ms_image, ms_seed = ss_image / (images - 1), ss_seed / (seeds - 1)
    inter = (ss_cell - ss_image - ss_seed) / ((images - 1) * (seeds - 1))
    within = (ss - ss_cell - ss_level) / (images * seeds * (levels - 1))
    split = variance_split(runs, "cre")
    assert _of(split, "image") ** 2 == pytest.approx((ms_image - inter) / (seeds * levels))
    assert _of(split, "seed") ** 2 == pytest.approx((ms_seed - inter) / (images * levels))
    assert _of(split, "severity") ** 2 == pytest.approx(ss_level / (images * seeds * (levels - 1)))
    assert _of(split, "rest") ** 2 == pytest.approx(inter / levels + within)
    variance_of_mean = (ms_image + ms_seed - inter) / (images * seeds * levels)
    assert (split["error_of_mean"].drop_nulls() ** 2).sum() == pytest.approx(variance_of_mean)


def test_one_seed_and_other_metrics_are_refused():
    runs = _runs(0.5, 0.1, 0.1, 2, np.random.default_rng(3))
    with pytest.raises(RunError, match="--seeds 2 or more"):
        variance_split({0: runs[0]})
    with pytest.raises(UsageError, match="metric"):
        variance_split(runs, "crer")
    with pytest.raises(RunError, match="no image was measured"):
        variance_split({0: runs[0], 1: runs[1].with_columns(sample=pl.lit("x") + pl.col("sample"))})


def test_models_that_do_not_differ_share_their_possible_ranks():
    rng = np.random.default_rng(4)
    hard = rng.lognormal(0, 0.5, 60)
    runs = {}
    for name, factor in (("good", 3.0), ("alike", 3.0), ("bad", 6.0)):
        errors = factor * hard[:, None] * rng.gamma(50, 1 / 50, (60, 3))
        runs[name] = rows_of(hard, errors, errors)
    table = standings(compare_all(runs, "epe", resamples=999), list(runs))
    assert table["model"].to_list()[2] == "bad"
    assert table.filter(model="bad").select("best", "worst").row(0) == (3, 3)
    assert table.filter(pl.col("model") != "bad").select("best", "worst").rows() == [(1, 2), (1, 2)]


def test_the_order_moves_with_the_condition():
    scores = {
        "seed 0": {"a": 1.0, "b": 2.0, "c": 3.0},
        "seed 1": {"a": 1.0, "b": 2.5, "c": 2.0, "only here": 0.0},
    }
    table = rank_stability(scores)
    assert set(table["model"]) == {"a", "b", "c"}
    second = table.filter(condition="seed 1")
    assert dict(second.select("model", "moved").iter_rows()) == {"a": 0, "b": 1, "c": -1}
    assert second["tau"][0] == pytest.approx(1 / 3)
    with pytest.raises(RunError, match="two models"):
        rank_stability({"seed 0": {"a": 1.0}, "seed 1": {"a": 1.0}})


def test_an_order_without_a_difference_has_no_tau():
    table = rank_stability({"seed 0": {"a": 1.0, "b": 1.0}, "seed 1": {"a": 1.0, "b": 2.0}})
    assert table["tau"].to_list() == [None] * 4
    assert "seed 1 (no tau: all scores under a condition are equal)" in render(
        stability_table(table, "cre"), "markdown"
    )


def test_seeds_on_the_command_line(tmp_path):
    """Each seed's folder equals that of a run with only this seed; `compare` shows how the order of models changes."""
    cli, folders = CliRunner(), []
    common = ["--corruptions", "gaussian_noise", "--severities", "3", "--no-examples"]
    for model in ("dis", "farneback", "dis_rgb"):
        made = cli.invoke(app, ["run", "--model", model, *common, "--seeds", "2", "--output", str(tmp_path / model)])
        assert made.exit_code == 0, made.output
        assert f"{['DIS', 'Farneback', 'DIS-RGB'][len(folders) // 2]} (seed 1)" in made.output
        assert "2 seeds" in made.output
        assert "mean ± standard deviation over the seeds 0 and 1" in made.output
        assert "robustflow compare" not in made.output  # a single pair cannot be compared
        folders += [str(tmp_path / model / f"seed{number}") for number in (0, 1)]
    alone = cli.invoke(app, ["run", "--model", "dis", *common, "--seed", "1", "--output", str(tmp_path / "alone")])
    assert alone.exit_code == 0, alone.output
    assert Run(tmp_path / "alone").rows.equals(Run(folders[1]).rows)
    assert not Run(folders[0]).rows.equals(Run(folders[1]).rows)
    moves = cli.invoke(app, ["compare", *folders])
    assert moves.exit_code == 0, moves.output
    assert "seed 0" in moves.output
    assert "tau" in moves.output
    assert "DIS-RGB" in moves.output
    order, _, reasons = moves.output.partition("Not ranked: ")
    assert "Farneback" not in order
    assert reasons.startswith("Farneback, because its clean EPE of 25.52 px")
    alone_ranked = cli.invoke(app, ["compare", *folders[:4]])
    assert "a ranking needs at least two models that can be ranked; not ranked: Farneback, because" in str(
        alone_ranked.exception
    )
    one_image = cli.invoke(app, ["compare", *folders[:2]])
    assert "the variance between images needs at least two" in str(one_image.exception) + one_image.output


@pytest.fixture
def seeds(base):
    """A function `seeds(model, *means)` that makes one run of a model per seed, with EPE equal to the clean EPE plus
    the given value.
    """

    def make(model: str, *means: float) -> list[Run]:
        errors = [np.full((IMAGES, 3), 1.0 + mean) for mean in means]
        rows = (rows_of(np.ones(IMAGES), one, one).filter(pl.col("corruption") != "snow") for one in errors)
        return [made_run(base, one, model, seed=seed) for seed, one in enumerate(rows)]

    return make


@pytest.mark.parametrize("name", ["cre", "means"])
def test_tables_have_the_mean_and_the_standard_deviation_over_seeds(seeds, name):
    """CRE 1, 2 and 6 px: mean 3, standard deviation sqrt(7)."""
    (table,) = tables_of([*seeds("A", 1.0, 2.0, 6.0), *seeds("B", 4.0)], published=False, wanted=[name])
    for format in FORMATS:
        text = render(table, format)
        assert all(f"A (seed {seed})" in text for seed in (0, 1, 2))
        assert "A, 3 seeds" in text
        assert "3.00{}2.65".format(r" \textpm{} " if format == "latex" else " ± ") in text
        assert "standard deviation over the seeds 0, 1 and 2" in text
        assert "B, 1" not in text


def test_runs_that_differ_in_more_than_the_seed_are_not_averaged(seeds):
    one, other = seeds("A", 1.0, 2.0)
    assert [group.label for group in seed_groups([one, other])] == ["A, 2 seeds"]
    assert seed_groups([one, *seeds("B", 1.0, 2.0)[1:]]) == []
    other.rows = other.rows.filter(pl.col("sample") != other.rows["sample"][0])
    assert seed_groups([one, other]) == []


@pytest.mark.parametrize(
    ("models", "question"),
    [
        ({"A": (1.0, 2.0)}, "How much depends on the seed?"),
        ({"A": (1.0, 2.0), "B": (2.0, 3.0)}, "Do the models keep their order with every seed?"),
        ({"A": (1.0,), "B": (2.0,)}, "Is the difference real?"),
    ],
)
def test_the_command_that_is_suggested_after_several_runs_works(seeds, capsys, monkeypatch, models, question):
    runs = [run for name, means in models.items() for run in seeds(name, *means)]
    print_results(runs)
    assert f"{question} robustflow compare" in capsys.readouterr().out
    by_path = dict(zip("abcd", runs, strict=False))
    monkeypatch.setattr("robustflow.records.load.load_any_run", lambda path: by_path[str(path)])
    compared = CliRunner().invoke(app, ["compare", *by_path])
    assert compared.exit_code == 0, compared.output
