"""Layout of figures: headings, names and bubbles stay readable for any number of models."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.text import Annotation

from robustflow.report.figures import clean_against_cre, effective_trend, figure_bytes
from robustflow.stats.results_file import parse_results


def _results(models: int, settings: int = 1, crer: float = 1.0):
    rng = np.random.default_rng(0)
    lines = ["setting,model,metric,corruption,value"]
    for setting in range(settings):
        for index in range(models):
            clean = float(rng.uniform(0.5, 4.0))
            error = clean * (1 + crer * rng.uniform(0.5, 1))
            lines.append(f"s{setting},Model {index},epe,clean,{clean:.3f}")
            lines.append(f"s{setting},Model {index},epe,average,{error:.3f}")
    return parse_results("\n".join(lines), "test", "test")


@pytest.mark.parametrize("draw", [clean_against_cre, effective_trend])
@pytest.mark.parametrize("settings", [1, 2])
def test_the_heading_is_as_wide_as_its_figure_at_most(draw, settings):
    figure = draw(_results(6, settings))
    figure.draw_without_rendering()
    heading = figure._suptitle.get_window_extent()
    assert heading.x0 >= 0
    assert heading.x1 <= figure.bbox.x1


@pytest.mark.parametrize("draw", [clean_against_cre, effective_trend])
def test_names_of_very_many_models_do_not_cover_each_other(draw, recwarn):
    figure = draw(_results(150))
    figure.draw_without_rendering()
    names = [text for text in figure.axes[0].texts if isinstance(text, Annotation) and text.get_visible()]
    assert 10 < len(names) < 150
    boxes = [text.get_window_extent() for text in names]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert not recwarn.list


@pytest.mark.parametrize(("draw", "number"), [(clean_against_cre, r" \d+\.\d\d$"), (effective_trend, r" ×\d+\.\d\d$")])
def test_long_names_keep_their_number_and_do_not_shrink_the_panel(draw, number):
    results = [replace(line, name=f"{'a long name ' * 6}{index}") for index, line in enumerate(_results(30))]
    figure = draw(results)
    (panel,) = figure.axes
    before = panel.get_position().bounds
    figure_bytes(figure, "svg")
    assert panel.get_position().bounds == before
    names = [text.get_text() for text in panel.texts if isinstance(text, Annotation)]
    assert all(re.search(number, name) for name in names)


def test_a_bubble_does_not_fill_its_panel():
    figure = clean_against_cre(_results(5, crer=300.0))
    sizes = [bubble.get_sizes()[0] for bubble in figure.axes[0].collections if isinstance(bubble, PathCollection)]
    assert 900 < max(sizes) <= 1000


def test_panels_of_many_settings_are_in_rows_of_three():
    figure = clean_against_cre(_results(2, settings=7))
    assert len(figure.axes) == 7
    assert figure.get_figwidth() < 16
