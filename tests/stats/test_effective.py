"""Effective robustness: known trends are recovered, and a model does not affect the line with which it is compared."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import linregress

from robustflow.core.errors import UsageError
from robustflow.stats.effective import effective_robustness
from robustflow.stats.lines import Lines, lines_of
from robustflow.stats.published.tables import published_lines
from robustflow.stats.results_file import parse_results
from tests.refusals import refusal

_OF_KITTI = {key: line for key, line in published_lines().items() if key.benchmark == "kitti-fc"}


def _results(models: dict[str, tuple[float, float]], setting: str = "OOD") -> Lines:
    lines = ["setting,model,metric,corruption,value"]
    for name, (clean, average) in models.items():
        lines += [f"{setting},{name},epe,clean,{clean!r}", f"{setting},{name},epe,average,{average!r}"]
    return lines_of(parse_results("\n".join(lines), "made.csv", "made"))


def test_planted_power_law_is_recovered_with_the_residual_of_an_outlier():
    models = {f"m{i}": (1.0 + i, 3.0 * (1.0 + i) ** 0.7) for i in range(8)}
    on_line = effective_robustness(_results(models))["OOD"]
    assert [one.factor for one in on_line.values()] == pytest.approx([1.0] * 8)
    models["m3"] = (4.0, 0.6 * 3.0 * 4.0**0.7)
    key, first = next(iter(effective_robustness(_results(models))["OOD"].items()))
    # The other models lie exactly on a line, so the result is exactly the planted factor.
    assert key.model == "m3"
    assert first.factor == pytest.approx(0.6)


def test_trend_is_fitted_per_setting_or_over_all():
    by_setting, together = effective_robustness(_OF_KITTI), effective_robustness(_OF_KITTI, by_setting=False)
    assert set(by_setting) == {"OOD", "ID"}
    assert len(together[""]) == 29


def test_expected_error_is_on_the_least_squares_line_of_scipy_through_the_others():
    models = {f"m{i}": (1.0 + i, 2.0 + (i * 7) % 5) for i in range(6)}
    for key, one in effective_robustness(_results(models))["OOD"].items():
        others = [errors for name, errors in models.items() if name != key.model]
        line = linregress(*np.log(others).T)
        assert one.expected == pytest.approx(np.exp(line.intercept + line.slope * np.log(one.clean)))


@pytest.mark.parametrize("models", [{f"m{i}": (1.0 + i, 2.0) for i in range(4)}, {f"m{i}": (1.0, i) for i in range(8)}])
def test_trend_of_too_few_different_models_is_refused(models):
    refusal(lambda: effective_robustness(_results(models)), UsageError, "")
