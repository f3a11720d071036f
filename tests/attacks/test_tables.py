"""Tables, curves, correlations and pages of runs with attacks."""

import numpy as np
import polars as pl
import pytest
from scipy.stats import spearmanr

import robustflow as rf
from robustflow.attacks.ball import GREY_LEVELS
from robustflow.attacks.registry import attack_spec
from robustflow.attacks.result import BESIDE_OTHERS, EXPLAINED, WARNINGS
from robustflow.report.attack_tables import attack_table, prediction_table, security_points
from robustflow.stats.attacks import attack_means, beside_others, budget_at_double, predictions, warnings_of
from robustflow.stats.ranking import spearman, spearman_interval

from .small_runs import numbers_of, run

pytest.importorskip("torch", reason="needs the torch extra")


def test_the_table_gives_the_gain_over_noise_and_marks_nothing_as_best(both):
    numbers = numbers_of(both)
    table, gain = attack_table(numbers), numbers.number("attack_gain", "pgd", 3)
    assert gain == pytest.approx(numbers.number("epe", "pgd", 3) - numbers.number("epe", "random_sign", 3))
    assert gain > 0
    assert numbers.number("attack_gain", "random_sign", 3) is None
    rows = both.attack_rows.filter(corruption="pgd", severity=3)
    assert numbers.number("epe", "pgd", 3) == pytest.approx((rows["epe_sum"] / rows["n_valid"]).mean())
    assert [line.label for section in table.sections for line in section.lines] == [
        f"{name} {level}" for name in ("random_sign", "fgsm", "pgd", "random_gauss") for level in (1, 3)
    ]
    cells = dict(zip((column.label for column in table.columns), _line(table, "pgd 3").cells, strict=True))
    for label, column in {"> 1 px (%)": "px1", "> 3 px (%)": "px3", "> 5 px (%)": "px5", "Fl (%)": "fl"}.items():
        assert cells[label].text == f"{(100 * rows[f'{column}_count'] / rows['n_valid']).mean():.2f}"
    assert cells["median (px)"].text == f"{rows['attack_median'].mean():.2f}"
    assert (cells["L-inf"].text, cells["RMS"].text) == ("4", f"{rows['attack_rms'].mean():.4g}")
    spent = both.manifest.seconds
    assert 0 < sum(spent[f"attack {name}"] for name in both.attacks) <= spent["attack"]
    assert cells["time (s)"].text == f"{spent['attack pgd'] / 4:.2f}"  # two pairs at two severities
    assert "target progress (%)" not in cells
    assert not any(cell.best for section in table.sections for line in section.lines for cell in line.cells)


def test_an_attack_on_one_frame_is_compared_with_noise_in_that_frame(tmp_path):
    done = run(tmp_path / "run", attacks="fgsm:moved=first", count=1, severities=3)
    scores, noise, fgsm = attack_means(done), ("random_sign:moved=first", 3), ("fgsm:moved=first", 3)
    assert scores["attack_linf", *noise] == 4
    assert scores["attack_rms", *noise] == pytest.approx(4 / np.sqrt(2), rel=0.05)  # in one of the two frames
    assert scores["attack_rms", "random_sign", 3] > 3.8
    assert scores["attack_gain", *fgsm] == scores["epe", *fgsm] - scores["epe", *noise]
    assert ("attack_gain", *noise) not in scores


def _line(table, label):
    return next(line for section in table.sections for line in section.lines if line.label == label)


def test_security_curves_begin_at_the_clean_error_and_have_the_means_of_the_rows(both):
    points = security_points(numbers_of(both))
    errors = {(point.attack, point.budget): point.error for point in points}
    rows = both.attack_rows.with_columns(epe=pl.col("epe_sum") / pl.col("n_valid"))
    for name in both.attacks:
        levels = GREY_LEVELS[attack_spec(name).norm]
        expected = {0.0: both.epe_clean}
        expected |= {levels[s - 1]: rows.filter(corruption=name, severity=s)["epe"].mean() for s in (1, 3)}
        assert {budget: error for (of, budget), error in errors.items() if of == name} == pytest.approx(expected)
    scores = attack_means(both)
    warned = {name for name in both.attacks for at in (1, 3) if warnings_of(scores, name, at)}
    assert {point.attack for point in points if point.warned} == warned


def test_security_curves_are_a_csv_and_a_figure_of_the_page(both, tmp_path, real_pictures, robustflow):
    robustflow.prints("report", both.path, "--table", "security", "-f", "csv", "-o", tmp_path / "curves.csv")
    error = pl.read_csv(tmp_path / "curves.csv").filter(pl.col("attack, budget") == "pgd 4")["error (px)"].item()
    assert error == pytest.approx(attack_means(both)["epe", "pgd", 3], abs=1e-3)
    with real_pictures():
        both.write_summary()
    assert 'id="attacks-0-title"' in (both.path / "report.html").read_text(encoding="utf-8")


def test_run_with_only_attacks_is_shown_on_a_page_and_in_the_terminal(tmp_path, capsys, real_pictures):
    from robustflow.cli.tables import print_result

    with real_pictures():
        alone = run(tmp_path / "run", attacks="fgsm", severities=2, count=1)
    print_result(alone)
    assert "fgsm 2" in capsys.readouterr().out
    assert '<section id="attacks"' in (alone.path / "report.html").read_text(encoding="utf-8")


class Shrunk:
    """DIS with a scaled flow, which changes its sensitivity to corruptions and noise."""

    def __init__(self, share: float) -> None:
        self.share, self.dis = share, rf.load_model("dis")

    def predict(self, frame1, frame2):
        return self.dis.predict(frame1, frame2) * np.float32(self.share)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Runs of five models, with noise as the attack."""
    folder = tmp_path_factory.mktemp("models")
    shares = (1.0, 0.7, 0.9, 0.6, 0.8)
    chosen = {"attacks": "random_sign", "corruptions": ["contrast", "high_light"]}
    return [run(folder / f"{share}", Shrunk(share), name=f"{share}", **chosen) for share in shares]


@pytest.mark.parametrize("shared_samples", [("0", "1"), ("0",)])
def test_the_correlation_of_corruptions_and_attacks_is_that_of_the_rows_of_common_samples(
    models, tmp_path, shared_samples
):
    compared = list(models)
    if len(shared_samples) == 1:
        chosen = {"attacks": "random_sign", "corruptions": ["contrast", "high_light"], "count": 1}
        compared.append(run(tmp_path / "run", Shrunk(0.75), name="0.75", **chosen))
    noise = next(one for one in predictions(compared) if one.attack == "random_sign")

    def increase(rows):
        rows = rows.filter(pl.col("severity") > 0, pl.col("sample").is_in(shared_samples))
        return ((rows["epe_sum"] - rows["clean_epe_sum"]) / rows["n_valid"]).mean()

    corrupted = [increase(one.rows) for one in compared]
    attacked = [increase(one.attack_rows.filter(corruption="random_sign")) for one in compared]
    assert len(noise.models) == len(compared)
    assert noise.rho == pytest.approx(spearmanr(corrupted, attacked).statistic)
    assert noise.interval[0] <= noise.rho <= noise.interval[1]


def test_severity_at_which_a_model_predicts_nothing_is_left_out_for_all_models(models, monkeypatch):
    rows = {id(one): one.attack_rows for one in models}
    lost = (pl.col("corruption") == "random_sign") & (pl.col("severity") == 3)
    rows[id(models[0])] = models[0].attack_rows.with_columns(n_valid=pl.when(lost).then(0).otherwise("n_valid"))
    monkeypatch.setattr(rf.Result, "attack_rows", property(lambda one: rows[id(one)]))
    noise = next(one for one in predictions(models) if one.attack == "random_sign")
    assert noise.severities == (1,)
    assert len(noise.models) == len(models)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_below_five_models_no_correlation_is_given_and_the_table_says_so(models, count):
    table = prediction_table(models[:count])
    assert len(table.columns) == 2  # those of the correlation are empty, so they are left out
    assert table.sections[0].lines[0].cells[1].text == f"{count}"
    assert table.sections[0].lines[0].note.startswith(f"{count} models: ")
    assert prediction_table(models[:1]) is None


@pytest.mark.parametrize(
    ("warning", "correlated"),
    [("rounding", True), ("gradient_zero", False), ("answers_differ", False), ("square_above_white_box", False)],
)
def test_a_lower_bound_is_correlated_and_a_score_that_says_little_is_not(models, monkeypatch, warning, correlated):
    doubtful = attack_means(models[0]) | {(f"warning {warning}", "random_sign", at): 1.0 for at in (1, 3)}
    monkeypatch.setattr(
        "robustflow.stats.attacks.attack_means", lambda one: doubtful if one is models[0] else attack_means(one)
    )
    noise = next(one for one in predictions(models) if one.attack == "random_sign")
    assert (noise.rho is not None) == correlated
    assert (noise.lower_bounds, noise.left_out) == ((("1.0",), {}) if correlated else ((), {"1.0": EXPLAINED[warning]}))
    if correlated:
        assert "lower bound for 1.0" in _line(prediction_table(models), "random_sign").note


def test_the_interval_of_a_rank_correlation_covers_the_true_one():
    rng = np.random.default_rng(0)
    true = 6 / np.pi * np.arcsin(0.6 / 2)  # for a bivariate normal distribution with correlation 0.6
    covered = 0
    for _ in range(400):
        first, noise = rng.normal(size=(2, 12))
        low, high = spearman_interval(spearman(first, 0.6 * first + 0.8 * noise), 12)
        covered += low <= true <= high
    assert 0.92 < covered / 400 < 0.99


def test_budget_that_doubles_the_error_is_interpolated_between_severities():
    scores = {("epe", "pgd", 1): 1.5, ("epe", "pgd", 3): 3.5}
    scores |= {("attack_budget", "pgd", 1): 1.0, ("attack_budget", "pgd", 3): 4.0}
    assert budget_at_double(scores, "pgd", 1.0) == pytest.approx(1 + 3 * 0.25)
    assert budget_at_double(scores, "pgd", 3.0) is None
    assert budget_at_double(scores, "pgd", None) is None


def test_a_white_box_attack_that_others_beat_carries_a_warning():
    errors = {"fgsm": 3, "pgd": 2, "square": 2.5, "apgd": 4, "transfer:raft": 3.5, "transfer:dis": 1.5}
    errors["pgd:moved=first"] = 1  # the others change both frames
    scores = {("epe", name, 1): epe for name, epe in errors.items()}
    scores |= {(measure, name, 1): 3.0 for name in errors for measure in ("attack_budget", "attack_pairs")}
    warned = scores | beside_others(scores)
    found = {name: set(warnings_of(warned, name, 1)) for name in errors if warnings_of(warned, name, 1)}
    assert found == {"pgd": set(BESIDE_OTHERS)}
    assert not set(BESIDE_OTHERS) & set(WARNINGS)
