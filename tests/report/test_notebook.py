"""A run's notebook output contains nothing executable, and its figures show the run's numbers."""

import io
import re
from base64 import b64decode
from functools import partial

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure
from PIL import Image

from robustflow.api import evaluate
from robustflow.core.errors import UsageError
from robustflow.report.run_tables import result_table
from robustflow.report.table import run_frame
from robustflow.stats.lines import lines_of
from robustflow.testing import BrightnessFlow
from tests.made_rows import made_run
from tests.refusals import refusal

from .elements import Elements


class Hostile(BrightnessFlow):
    """A model whose name contains markup, a formula and an escape sequence."""

    def identity(self):
        return {"name": "<img src=x onerror=alert(1)>$x_$\x1b[31m"}


@pytest.fixture(scope="module")
def runs(small_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    return [small_run, evaluate(Hostile(), "demo", output=folder, corruptions=["contrast", "fog"], severities=[1, 5])]


def test_notebook_shows_tables_and_figures(runs):
    html = runs[0]._repr_html_()
    elements = Elements(html).found
    (picture,) = [attributes for tag, attributes in elements if tag == "img"]
    kind, _, data = picture["src"].partition(",")
    assert kind == "data:image/png;base64"
    assert Image.open(io.BytesIO(b64decode(data))).format == "PNG"
    table = result_table(*next(iter(lines_of(run_frame([runs[0]])).items())))
    cells = {line.label: [cell.text for cell in line.cells] for line in table.sections[0].lines}
    run = runs[0]
    assert cells["all"] == [f"{v:.2f}" for v in (run.epe, run.cre, run.rcre, run.crer)]
    assert cells["Weather"][2] == f"{run.mean('rcre', 'fog'):.2f}"
    assert all(f">{text}<" in html for text in cells["all"])


def test_hostile_name_stays_text_in_a_notebook(runs):
    html = runs[1]._repr_html_()
    elements = Elements(html).found
    assert {tag for tag, _ in elements} <= {
        *("figure", "figcaption", "table", "thead", "tbody", "tr", "th", "td", "b", "p", "sup", "img")
    }
    assert not [name for _, attributes in elements for name in attributes if name.startswith("on")]
    assert "&lt;img src=x onerror=alert(1)&gt;" in html
    assert "\x1b" not in html + repr(runs[1])
    assert re.fullmatch("<Result of .*>", repr(runs[1]))


@pytest.mark.parametrize("kind", ["severity", "classes", "accuracy"])
def test_every_kind_of_plot_is_drawn(runs, kind):
    figure = runs[0].plot(kind)
    assert isinstance(figure, Figure)
    assert figure._repr_png_().startswith(b"\x89PNG")
    plot = runs[0].plot(kind, others=[runs[1]])
    assert plot._repr_png_() != figure._repr_png_()


def test_lines_of_a_plot_equal_the_means(runs):
    figure = runs[0].plot("severity", "epe")
    lines = {panel.get_title(): panel.lines[0].get_ydata() for panel in figure.axes}
    by_severity = [runs[0].mean("epe", "fog", level) for level in runs[0].measured.corruptions["fog"]]
    np.testing.assert_allclose(lines["Fog"], by_severity, rtol=1e-12)


def test_impossible_plots_are_refused(runs):
    for arguments, culprit in (
        (("severities",), "severities"),
        (("severity", "speed"), "speed"),
        (("relations",), "relations"),
    ):
        refusal(partial(runs[0].plot, *arguments), UsageError, culprit)
    other = made_run(runs[0], runs[0].rows.filter((pl.col("corruption") != "contrast") & (pl.col("severity") < 5)))
    refusal(lambda: runs[0].plot("classes", others=[other]), UsageError, "classes")
    with pytest.warns(UserWarning, match="fog"):
        runs[0].plot("severity", others=[other])


def test_plots_without_ground_truth_show_rcre(runs_without_truth):
    run = runs_without_truth[0]
    html = run._repr_html_()
    assert "RCRE (px)" in html
    assert "<img" not in html
    assert run.plot("severity")._repr_png_()
    with pytest.raises(UsageError):
        run.plot("classes")
    assert run.cost is None
