"""Notebook output of a run, and the building blocks of safe HTML pages."""

from __future__ import annotations

import hashlib
import json
import warnings
from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from ..core.errors import UsageError, unknown_name
from ..metrics.measures import MEASURES
from ..metrics.rows import CLEAN
from ..run.comparable import common_to, differences, named_runs
from ..run.displacement import displacements_of
from ..stats.estimate import cubes_of, estimate
from ..stats.lines import Numbers, lines_of
from .render import render
from .run_tables import result_table
from .table import run_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..run.run import Run


@cache
def templates(package: str) -> Environment:
    """Return the Jinja environment for a package's `templates` folder, with autoescaping on."""
    return Environment(loader=PackageLoader(package), autoescape=True, trim_blocks=True, lstrip_blocks=True)


def asset(package: str, name: str) -> str:
    """Return the text of a file in a package's `assets` folder."""
    return (files(package) / "assets" / name).read_text(encoding="utf-8")


def json_block(value: Any) -> Markup:
    """Serialise to JSON that is safe inside `<script type="application/json">`: no string in it can close the
    element.
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def content_policy(script: str) -> str:
    """Return a Content-Security-Policy that allows inline styles, embedded pictures, and this script by its hash."""
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; base-uri 'none'; "
        "form-action 'none'"
    )


def result_html(run: Run) -> str:
    """Return HTML with the means by corruption class, and the CREr figure if there is ground truth. All text is
    escaped, and the figure is embedded, so nothing is loaded from the network."""
    from .figures import figure_bytes

    ((key, numbers),) = lines_of(run_frame([run])).items()
    fragment = render(result_table(key, numbers), "html")
    try:
        figure = plot([run], "classes")
    except UsageError:
        return fragment  # without ground truth there is no CREr
    picture = b64encode(figure_bytes(figure, "png")).decode()
    about = 'alt="CREr by corruption class" style="max-width: 32em"'
    return f'{fragment}<img {about} src="data:image/png;base64,{picture}">'


def plot(runs: Sequence[Run], kind: str = "severity", metric: str = "rcre") -> Figure:
    """Draw a figure of one or more runs."""
    from . import figures

    of_results: dict[str, Callable[..., Figure]] = {
        "classes": figures.crer_by_family,
        "accuracy": figures.clean_against_cre,
        "relations": figures.relations,
    }
    if kind not in (kinds := ("severity", "displacement", *of_results)):
        raise unknown_name("plot", kind, kinds)
    if metric not in MEASURES:
        raise unknown_name("metric", metric, MEASURES)
    if kind == "displacement":
        return figures.displacement_figure(displacements_of(runs))
    named = named_runs(runs)
    if kind == "severity":
        common = common_to(named)
        if common.remark:
            warnings.warn(common.remark, stacklevel=2)
        curves = {}
        for name, cube in cubes_of(common.rows).items():
            scopes = [at for at in cube.conditions if at[0] != CLEAN]
            rows = estimate(cube, {metric: MEASURES[metric]}, scopes).to_dicts()
            curves[name] = Numbers(((metric, row["condition"], row["severity"]), row) for row in rows)
        return figures.severity_curves(curves, metric)
    if words := differences(named):
        raise UsageError(kind, f"the runs measured different conditions ({words}); plot them separately")
    return of_results[kind](lines_of(run_frame(runs, intervals=True)))
