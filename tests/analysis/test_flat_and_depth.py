"""Flat corruptions are compared with their 3D counterparts for models with known errors."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.analysis.flat_and_depth import TWINS, twin_comparisons
from robustflow.corruptions.registry import CORRUPTIONS, FURTHER
from robustflow.datasets import load_dataset
from robustflow.errors import UsageError
from robustflow.report.assemble import tables_of
from robustflow.report.render import render
from robustflow.runs.run import Run

SHAPES = {"pairs": 6, "size": "32x48"}
ERRORS = {
    "a": (1.0, 2.0), "b": (2.0, 1.0), "c": (3.0, 5.0), "d": (4.0, 4.0), "e": (5.0, 9.0)
}  # fmt: skip
"""Error in pixels under fog and fog_3d; the ranks are 1 2 3 4 5 and 2 1 4 3 5, so Spearman's rho is 1 - 6 * 4 / 120 =
0.8.
"""


class Offset:
    """The true flow plus the given error."""

    def __init__(self, name):
        self._name = name

    def identity(self):
        return {"name": self._name}

    def lookup(self, key, corruption, severity):
        sample = load_dataset("shapes", **SHAPES).load(key)
        flat, deep = ERRORS[self._name]
        error = {"clean": 0.0, "fog": flat, "fog_3d": deep}[corruption]
        spread = (int(key) - 2.5) / 10 if corruption == "fog_3d" else 0
        return sample.flow + np.float32([error + spread, 0])


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    made = []
    for name in ERRORS:
        result = rf.evaluate(
            Offset(name), "shapes", output=tmp_path_factory.mktemp("twins") / name, corruptions=["fog", "fog_3d"],
            severities=[3], data_options=SHAPES, examples=False, name=name, workers=1,
        )  # fmt: skip
        made.append(Run(result.path))
    return made


def test_differences_and_rank_correlation_are_those_of_the_errors(runs):
    (one,) = twin_comparisons(runs)
    assert (one.flat, one.deep, one.severities, one.metric, one.count) == ("fog", "fog_3d", (3,), "cre", 5)
    for model in one.models:
        flat, deep = ERRORS[model.model]
        assert model.flat == pytest.approx(flat, abs=1e-4)
        assert model.deep == pytest.approx(deep, abs=1e-4)
        assert model.difference == pytest.approx(deep - flat, abs=1e-4)
        assert model.low < deep - flat < model.high  # the pairs differ by 0.5 px
        assert model.high - model.low < 1
    assert one.rho == pytest.approx(0.8)
    assert one.interval[0] < 0.8 < one.interval[1]


def test_the_table_has_a_line_for_each_correlation_and_each_model(runs):
    (table,) = tables_of(runs, published=False, wanted=["flat-and-depth"])
    assert "+0.80" in render(table, "markdown")
    assert table.sections[1].title == "fog and fog_3d, severities 3"
    assert [line.label for line in table.sections[1].lines] == list(ERRORS)


def test_few_models_have_differences_and_no_correlation(runs):
    (one,) = twin_comparisons(runs[:2])
    assert (one.rho, one.interval, len(one.models)) == (None, None, 2)
    (table,) = tables_of(runs[:1], published=False, wanted=["flat-and-depth"])
    assert "too few for a correlation" in render(table, "markdown")


def test_runs_without_twins_have_no_such_table(tmp_path):
    alone = rf.evaluate(
        Offset("a"), "shapes", output=tmp_path / "run", corruptions=["fog"], severities=[3], data_options=SHAPES,
        examples=False, workers=1,
    )  # fmt: skip
    assert twin_comparisons([Run(alone.path)]) == []
    with pytest.raises(UsageError, match="fog,fog_3d"):
        tables_of([Run(alone.path)], published=False, wanted=["flat-and-depth"])


def test_every_twin_exists_and_is_one_by_depth():
    for flat, deep in TWINS:
        assert flat in CORRUPTIONS.names()
        assert deep in FURTHER["depth"]
