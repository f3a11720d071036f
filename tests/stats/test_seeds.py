"""Test the sources of a score's variance, and rankings with ties."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from robustflow.cli.main import app
from robustflow.cli.tables import print_results
from robustflow.core.errors import RunError, UsageError
from robustflow.report.render import FORMATS, render
from robustflow.report.tables import tables_of
from robustflow.run.run import Run
from robustflow.stats.paired import group_letters, standings
from robustflow.stats.seeds import seed_groups, seeds_of
from robustflow.stats.variance import variance_split
from tests.made_rows import made_run
from tests.refusals import refusal

from .simulated import compare_all, rows_of

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


def _runs_with_scores(y: np.ndarray) -> dict[int, pl.DataFrame]:
    """Runs of fog whose CRE is y, float64 (images, seeds, severities), with up to three severities."""
    images, seeds, levels = y.shape
    runs = {}
    for seed in range(seeds):
        errors = np.concatenate([1 + y[:, seed], np.ones((images, 3 - levels))], axis=1)
        snow = pl.col("corruption") == "snow"
        rows = rows_of(np.ones(images), errors, errors)
        rows = rows.with_columns(severity=pl.when(snow).then(pl.lit(5, pl.Int64)).otherwise("severity"))
        rows = rows.with_columns(corruption=pl.when(snow).then(pl.lit("fog")).otherwise("corruption"))
        runs[seed] = rows.filter(pl.col("severity") <= (0, 1, 3, 5)[levels])
    return runs


def test_split_of_three_images_equals_variances_computed_by_hand():
    """Scores of three images (rows) with two seeds (columns) at severity 1 and at severity 3."""
    y = np.array([[[0.0, 4.0], [2.0, 6.0]], [[1.0, 7.0], [1.0, 7.0]], [[5.0, 13.0], [7.0, 9.0]]])
    split = variance_split(_runs_with_scores(y), "cre")
    # means of the images 3, 4, 8.5; of the seeds 5, 16/3; of the severities 8/3, 23/3; of all 31/6
    # mean squares: image 103/3, seed 1/3, image x seed 7/3, image x severity 1, seed x severity 3, residual 3
    assert _of(split, "image") ** 2 == pytest.approx((103 / 3 - 7 / 3) / 4)
    assert _of(split, "seed") == 0  # (1/3 - 7/3) / 6 is negative
    assert _of(split, "severity") ** 2 == pytest.approx(12.5)
    both, of_image, of_seed, residual = (7 / 3 - 3) / 2, (1 - 3) / 2, (3 - 3) / 3, 3
    assert _of(split, "rest") ** 2 == pytest.approx(both + (of_image + of_seed) / 2 + residual)
    assert (split["error_of_mean"].drop_nulls() ** 2).sum() == pytest.approx(8 / 3 + 7 / 3 / 12)


@pytest.mark.parametrize("severity_scores", [[0.0], [0.0, 5.0], [0.0, 5.0, 6.0]])
def test_split_of_scores_without_interactions_equals_the_variance_of_each_source(severity_scores):
    images, seeds, severities = np.array([1.0, 3.0, 8.0, 9.0]), np.array([0.0, 4.0, 5.0]), np.array(severity_scores)
    split = variance_split(_runs_with_scores(images[:, None, None] + seeds[:, None] + severities), "cre")
    counts = {"image": 4, "seed": 3, "severity": severities.size, "rest": 12 * severities.size}
    assert dict(split.select("source", "levels").iter_rows()) == counts
    of_severity = severities.var(ddof=1) if severities.size > 1 else 0.0
    variances = np.array([images.var(ddof=1), seeds.var(ddof=1), of_severity, 0.0])
    assert split["deviation"].to_numpy() ** 2 == pytest.approx(variances)
    assert split["share"].to_numpy() == pytest.approx(100 * variances / variances.sum())
    assert split["error_of_mean"][0] ** 2 == pytest.approx(variances[0] / 4)
    assert split["error_of_mean"][1] ** 2 == pytest.approx(variances[1] / 3)
    assert split["error_of_mean"][2] is None


@pytest.mark.parametrize("severities", [1, 2, 3])
def test_rest_of_pure_noise_is_its_deviation_at_any_number_of_severities(severities):
    rng = np.random.default_rng(6)
    noise = [rng.normal(0, 1, (40, 3, severities)) for _ in range(25)]
    rests = [_of(variance_split(_runs_with_scores(y + 5), "cre"), "rest") ** 2 for y in noise]
    standard_error = np.sqrt(2 / (40 * 3 * severities) / len(rests)) * 1.5  # estimates with fewer degrees of freedom
    assert np.mean(rests) == pytest.approx(1, abs=3 * standard_error)


TWO = _runs(0.5, 0.1, 0.1, 2, np.random.default_rng(3))
REFUSED = [
    (lambda: variance_split({0: TWO[0]}), RunError, "--seeds"),
    (lambda: variance_split(TWO, "crer"), UsageError, "crer"),
    (lambda: variance_split({0: TWO[0], 1: TWO[1].with_columns(sample="x" + pl.col("sample"))}), RunError, ""),
    (lambda: variance_split({seed: rows.filter(sample="00000") for seed, rows in TWO.items()}), RunError, ""),
]


@pytest.mark.parametrize(("call", "error", "culprit"), REFUSED)
def test_runs_without_a_variance_or_ranks_are_refused(call, error, culprit):
    refusal(call, error, culprit)


def test_equal_models_share_their_possible_ranks():
    rng = np.random.default_rng(4)
    hard = rng.lognormal(0, 0.5, 60)
    runs = {}
    for name, factor in (("good", 3.0), ("alike", 3.0), ("bad", 6.0)):
        errors = factor * hard[:, None] * rng.gamma(50, 1 / 50, (60, 3))
        runs[name] = rows_of(hard, errors, errors)
    table = standings(compare_all(runs, "epe"), list(runs))
    assert table["model"].to_list()[2] == "bad"
    assert table.filter(model="bad").select("best", "worst").row(0) == (3, 3)
    assert table.filter(pl.col("model") != "bad").select("best", "worst").rows() == [(1, 2), (1, 2)]


def test_each_seed_of_the_command_line_is_a_run_with_this_seed_alone(tmp_path):
    cli, options = CliRunner(), ["--corruptions", "gaussian_noise", "--severities", "3", "--no-examples"]
    for name, seeds in (("both", ("--seeds", "2")), ("alone", ("--seed", "1"))):
        made = cli.invoke(app, ["run", "--model", "dis", *options, *seeds, "--output", str(tmp_path / name)])
        assert made.exit_code == 0, made.output
    first, second = (Run(tmp_path / "both" / f"seed{number}") for number in (0, 1))
    assert second.rows.equals(Run(tmp_path / "alone").rows)
    assert not second.rows.equals(first.rows)
    assert isinstance(cli.invoke(app, ["compare", str(first.path), str(second.path)]).exception, RunError)  # one image


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
        assert "B, 1" not in text


def test_runs_that_differ_in_more_than_the_seed_are_not_averaged(seeds):
    one, other = seeds("A", 1.0, 2.0)
    assert seed_groups([one, other]) == {"A": [one, other]}
    another = seeds("B", 1.0, 2.0)[1]
    assert seed_groups([one, another]) == {}
    assert seeds_of([one, another]) is None
    other.rows = other.rows.filter(pl.col("sample") != other.rows["sample"][0])
    assert seed_groups([one, other]) == {}


@pytest.mark.parametrize(
    ("models", "suggested"),
    [({"A": (1.0, 2.0)}, True), ({"A": (1.0,), "B": (2.0,)}, True), ({"A": (1.0, 2.0), "B": (2.0, 3.0)}, False)],
    ids=["seeds", "models", "seeds of models"],
)
def test_command_that_is_suggested_after_several_runs_works(seeds, capsys, monkeypatch, models, suggested):
    runs = [run for name, means in models.items() for run in seeds(name, *means)]
    print_results(runs)
    assert ("robustflow compare" in capsys.readouterr().out) == suggested
    if suggested:
        by_path = dict(zip("abcd", runs, strict=False))
        monkeypatch.setattr("robustflow.run.records.pack.load_any_run", lambda path: by_path[str(path)])
        compared = CliRunner().invoke(app, ["compare", *by_path])
        assert compared.exit_code == 0, compared.output


@pytest.mark.parametrize("seed", range(20))
def test_models_share_a_group_letter_if_and_only_if_no_test_tells_them_apart(seed):
    rng, names = np.random.default_rng(seed), "ABCDEFGHIJKLMNOPQRST"[: 8 if seed % 2 else 20]
    apart = {pair: bool(rng.random() < (0.1, 0.3, 0.5, 0.8)[seed // 2 % 4]) for pair in combinations(names, 2)}
    rows = [{"model": a, "against": b, "p_adjusted": 0.01 if apart[a, b] else None, "value": -1.0} for a, b in apart]
    letters = group_letters(rows, names)
    assert letters["A"].startswith("a")
    assert all(bool(set(letters[a]) & set(letters[b])) != far for (a, b), far in apart.items())
    together = ["".join(name for name in names if letter in letters[name]) for letter in set("".join(letters.values()))]
    assert not any(set(one) <= set(other) for one, other in permutations(together, 2)), "no letter is redundant"
