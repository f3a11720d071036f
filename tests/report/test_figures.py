"""Figures show the given numbers, are comparable, and render every name as plain, readable text."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import polars as pl
import pytest
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from robustflow.core.errors import UsageError
from robustflow.metrics.measures import MEASURES
from robustflow.report.figures import (
    FILE_FORMATS,
    all_figures,
    clean_against_cre,
    crer_by_family,
    effective_trend,
    figure_bytes,
    figures_by_sample_set,
    relations,
    severity_curves,
    write_figures,
)
from robustflow.report.figures.canvas import new_figure, spread_labels
from robustflow.report.figures.curves import scale_panels
from robustflow.report.figures.styles import KIND_STYLES, MODEL_STYLES, FigureStyles
from robustflow.stats.estimate import cubes_of, estimate
from robustflow.stats.lines import LineKey, Lines, Numbers, lines_of
from robustflow.stats.published.tables import published_lines
from robustflow.stats.results_file import parse_results

from ..refusals import refusal
from ..stats.simulated import Truth, rows_of
from .hostile import HOSTILE

_KITTI = {key: line for key, line in published_lines().items() if key.benchmark == "kitti-fc"}


def _rows(seed: int = 0, count: int = 12) -> pl.DataFrame:
    clean, corrupted = Truth().draw(np.random.default_rng(seed), np.ones(count, int))
    return rows_of(clean, corrupted, corrupted)


def _curves(rows: pl.DataFrame) -> Numbers:
    """The EPE and the RCRE of rows by severity."""
    (cube,) = cubes_of({"": rows}).values()
    measures = {name: MEASURES[name] for name in ("epe", "rcre")}
    known = estimate(cube, measures, [at for at in cube.conditions if at[1]]).to_dicts()
    return Numbers(((row["measure"], row["condition"], row["severity"]), row) for row in known)


def _run(rows: pl.DataFrame) -> Numbers:
    facts = {"source": "measured", "excluded": "", "note": "", "coverage": None}
    return Numbers((key, row | facts) for key, row in _curves(rows).items())


def _renamed(lines: Lines, rename) -> Lines:
    return {key._replace(model=rename(key.model)): line for key, line in lines.items()}


def _changed(lines: Lines, change) -> Lines:
    """Lines with changed rows."""
    return {key: Numbers((of, row | change(key, row)) for of, row in line.items()) for key, line in lines.items()}


def _texts(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text")))


def _edges(figure: Figure, axis: str) -> set[tuple[float, float]]:
    return {getattr(panel, f"get_{axis}lim")() for panel in figure.axes}


def _own(*settings: str, weather: bool = False, cre: bool = False) -> Lines:
    cells = [("epe", "clean", 0), ("epe", "average", 3), ("rcre", "average", 1), *[("cre", "average", 0)] * cre]
    cells += [("epe", "fog", 2), ("epe", "jpeg_compression", 1)] * weather
    lines = [
        f"{setting},M{index},{metric},{corruption},{2 + index + extra:.2f}\n"
        for index, setting in enumerate(settings)
        for metric, corruption, extra in cells
    ]
    return lines_of(parse_results("setting,model,metric,corruption,value\n" + "".join(lines), "own.csv", "own frames"))


def _many(models: int, settings: int = 1, crer: float = 1.0) -> Lines:
    rng = np.random.default_rng(0)
    lines = ["setting,model,metric,corruption,value"]
    for setting in range(settings):
        for index in range(models):
            clean = float(rng.uniform(0.5, 4.0))
            error = clean * (1 + crer * rng.uniform(0.5, 1))
            lines += [f"s{setting},Model {index},epe,{on},{v:.3f}" for on, v in (("clean", clean), ("average", error))]
    return lines_of(parse_results("\n".join(lines), "test", "test"))


def test_bubbles_are_at_the_positions_of_their_numbers():
    """RAFT in-domain has a clean EPE of 1.81, a CRE of 6.70 and a CREr of 3.70; a bubble's area is proportional to
    CREr. SAMFlow-T's CREr is as printed, although its EPE gives 1.21, and the differing CRE is named."""
    figure = clean_against_cre(_KITTI)
    assert len(figure.axes) == 2
    bubbles = [c for c in figure.axes[1].collections if c.get_sizes()[0] > 10]
    places = {tuple(np.round(b.get_offsets()[0], 2)): b.get_sizes()[0] for b in bubbles}
    assert len(places) == 14
    assert places[1.81, 6.70] / places[3.02, 2.74] == pytest.approx(3.70 / 0.91)
    assert all(name in _texts(figure) for name in ("RAFT 3.70", "SAMFlow-T 1.17"))
    marks = [mark for of_part in figure.marks.values() for mark in of_part if mark.model == "SAMFlow-T" and mark.values]
    shown = next(dict(mark.values) for mark in marks if mark.setting == "OOD")
    assert (shown["CREr"], shown["CRE"]) == ("1.17", "5.10 px from the EPE, 4.97 px as published")
    assert "FlowDiffuser" not in _texts(figure)
    assert "Farneback" not in _texts(figure)
    large = clean_against_cre(_many(5, crer=300.0)).axes[0].collections
    assert 900 < max(bubble.get_sizes()[0] for bubble in large if isinstance(bubble, PathCollection)) <= 1000


def test_a_name_in_any_script_warns_only_where_the_font_draws_a_box(recwarn):
    few = {key: line for key, line in _KITTI.items() if key.model in ("RAFT", "GMA")}
    results = _renamed(few, lambda name: "\u5149\u6d41" if name == "RAFT" else name)
    assert "\u5149\u6d41" in figure_bytes(clean_against_cre(results), "svg", live_text=True).decode()
    assert not [one.message for one in recwarn if one.category is not ResourceWarning]
    with pytest.warns(UserWarning, match="20809"):
        figure_bytes(clean_against_cre(results), "png")


@pytest.mark.parametrize("draw", [clean_against_cre, effective_trend])
def test_names_and_headings_are_readable_for_any_number_of_models(draw, recwarn):
    """Names do not cover each other or shrink the panel; of very many, only those that fit are shown."""
    for results in (_KITTI, _many(6, 2), _many(150)):
        figure = draw(results)
        figure.draw_without_rendering()
        heading = figure._suptitle.get_window_extent()
        assert heading.x0 >= 0
        assert heading.x1 <= figure.bbox.x1
        for axes in figure.axes:
            names = [text for text in axes.texts if isinstance(text, Annotation) and text.get_visible()]
            boxes = [text.get_window_extent() for text in names]
            assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert 10 < len(names) < 150
    assert not [one.message for one in recwarn if one.category is not ResourceWarning]
    figure = draw(_renamed(_many(30), lambda name: f"{'a long name ' * 6}{name}"))
    (panel,) = figure.axes
    before = panel.get_position().bounds
    figure_bytes(figure, "svg")
    assert panel.get_position().bounds == before
    names = [text.get_text() for text in panel.texts if isinstance(text, Annotation)]
    assert names
    assert all(re.search(r"\d+\.\d\d$", name) for name in names)


def test_a_name_nearest_to_a_different_bubble_is_connected_with_its_own():
    figure = clean_against_cre(_KITTI)
    figure.draw_without_rendering()
    for axes in figure.axes:
        bubbles = [c for c in axes.collections if c.get_sizes()[0] > 10]
        places = np.concatenate([bubble.get_offsets() for bubble in bubbles])
        centres = axes.transData.transform(places)
        radii = [np.sqrt(bubble.get_sizes()[0] / np.pi) * figure.dpi / 72 for bubble in bubbles]
        connected = {tuple(np.round(line.get_xydata()[0], 6)) for line in axes.lines}
        for index, text in enumerate(axes.texts):
            box = text.get_window_extent()
            nearest = np.clip(centres, (box.x0, box.y0), (box.x1, box.y1))
            gaps = np.linalg.norm(centres - nearest, axis=1) - radii
            assert gaps.argmin() == index or tuple(np.round(places[index], 6)) in connected, text.get_text()


def test_family_means_in_the_figure_equal_hand_computed_values():
    """CSFlow under noise, out-of-domain: the mean of 10.82, 9.75 and 10.95, divided by 4.11, minus 1."""
    families = {(key.setting, key.model): line.family_crer() for key, line in _KITTI.items()}
    assert families["OOD", "CSFlow"]["noise"] == pytest.approx((10.82 + 9.75 + 10.95) / 3 / 4.11 - 1)
    figure = crer_by_family(_KITTI)
    assert [axes.get_title() for axes in figure.axes] == ["SAMFlow-H", "CSFlow", "ARFlow"]
    heights = [bar.get_height() for bar in figure.axes[2].patches]
    assert heights == pytest.approx(list(families["ID", "ARFlow"].values()))
    ((low, _),) = _edges(figure, "y")
    assert low == 0


def test_relations_figure_states_its_correlations():
    figure = relations(_KITTI)
    drawn = {gid: marks[0] for gid, marks in figure.marks.items()}
    dots = [dot for dot in figure.axes[3].collections if drawn[dot.get_gid()].setting == "OOD"]
    offsets = np.concatenate([dot.get_offsets() for dot in dots])
    assert len(offsets) == 11
    assert f"OOD: r = {np.corrcoef(offsets.T)[0, 1]:.2f}" in figure.axes[3].get_title(loc="left")
    panels = figure.axes
    assert {panel.get_xlim() for panel in panels[:3]} == {panels[0].get_xlim()}
    assert panels[2].get_ylim() == panels[3].get_ylim()
    assert panels[1].get_ylim() == panels[3].get_xlim()


@pytest.mark.parametrize("draw", [clean_against_cre, crer_by_family, effective_trend])
def test_panels_beside_each_other_have_the_same_axes(draw):
    figure = draw(_KITTI)
    assert len(figure.axes) > 1
    assert len(_edges(figure, "x")) == len(_edges(figure, "y")) == 1


def test_axes_of_small_values_span_at_least_one_pixel():
    """Two models 0.11 px apart, and curves that reach 0.11 px."""
    close = _changed(_own("OOD", "OOD"), lambda key, _: {"value": 2.6 + 0.1 * (key.model == "M1")})
    figure = clean_against_cre(close)
    assert all(high - low >= 1 for axis in "xy" for low, high in _edges(figure, axis))
    assert figure.axes
    still = _rows().with_columns(rcre_sum=pl.col("n_valid") * 0.11 * pl.col("severity") / 5)
    ((low, high),) = _edges(severity_curves({"a": _curves(still)}), "y")
    assert low == 0
    assert high >= 1


_ENDS = {
    ("epe", "clean"): (1.9, 2.2),
    ("epe", "average"): (4.0, 6.1),
    ("cre", "average"): (2.5, 3.6),
    ("crer", "weather"): (0.8, 1.4),
    ("rcre", "average"): (2.9, 3.1),
}


def _vertical_lines(figure: Figure) -> list[tuple[float, float]]:
    lines = [line.get_xydata() for panel in figure.axes for line in panel.lines]
    return [tuple(line[:, 1]) for line in lines if len(line) == 2 and line[0, 0] == line[1, 0]]


@pytest.mark.parametrize(
    ("draw", "key"),
    [
        (clean_against_cre, ("cre", "average")),
        (crer_by_family, ("crer", "weather")),
        (relations, ("rcre", "average")),
        (effective_trend, ("epe", "average")),
    ],
)
def test_intervals_are_drawn_and_mentioned_where_there_are_any(draw, key):
    results = _own("OOD", "OOD", "OOD", "UNKNOWN", "UNKNOWN", weather=True, cre=True)
    without = draw(results)
    assert "intervals" not in without.caption
    assert not _vertical_lines(without)

    def with_ends(line, row):
        ends = _ENDS.get((row["measure"], row["condition"]))
        return dict(zip(("low", "high"), ends, strict=True)) if ends and line.model == "M1" else {}

    results = _changed(results, with_ends)
    figure = draw(results)
    assert "95 %" in figure.caption
    assert _ENDS[key] in [pytest.approx(line) for line in _vertical_lines(figure)]
    low, high = _ENDS[key]
    values = {value for marks in figure.marks.values() for mark in marks for _, value in mark.values}
    assert any(value.endswith(f" [{low:.2f}, {high:.2f}]") for value in values)


def test_too_few_or_too_many_models_are_refused_or_left_out():
    four = _own("OOD", "OOD", "OOD", "OOD")
    too_few = [(relations, four), (effective_trend, four), (crer_by_family, _own("OOD"))]
    for draw, results in [
        *too_few,
        *((draw, {}) for draw in (clean_against_cre, crer_by_family, relations, effective_trend)),
    ]:
        with pytest.raises(UsageError):
            draw(results)
    refusal(lambda: severity_curves({str(i): _curves(_rows()) for i in range(9)}), UsageError, "9 runs")
    five = _own(*["OOD"] * 5)
    in_domain = {key._replace(setting="ID"): line for key, line in list(five.items())[:3]}
    title = relations(five | in_domain).axes[0].get_title(loc="left")
    assert "OOD: r = " in title
    assert "ID: r" not in title.replace("OOD: r", "")
    figure = clean_against_cre(_many(2, settings=7))
    assert len(figure.axes) == 7
    assert figure.get_figwidth() < 16


def test_family_figure_shows_at_most_as_many_models_as_styles():
    """The models with the lowest error are shown, in the colours of the other figures."""
    results = dict(reversed(_own(*["OOD"] * 10, weather=True).items()))
    styles = {line: MODEL_STYLES[int(line.model[1:])] for line in list(results)[2:]}
    figure = crer_by_family(results, FigureStyles(styles))
    assert {(mark.model) for marks in figure.marks.values() for mark in marks} == {f"M{index}" for index in range(8)}
    key = {line.model: replace(style, marker="s") for line, style in styles.items()}
    assert dict(entry[:2] for entry in figure.key) == key
    assert "8 of 10" in _texts(figure)


def test_a_model_looks_alike_in_every_figure_and_unlike_every_kind():
    kinds, models = ([style.colour for style in styles] for styles in (KIND_STYLES.values(), MODEL_STYLES))
    assert len({*kinds, *models}) == len(kinds) + len(models)
    results = _own("knowledge", "OOD", "ID", "UNKNOWN", "UNKNOWN", weather=True)
    styles = FigureStyles({line: MODEL_STYLES[7 - int(line.model[1:])] for line in results})
    figures = figures_by_sample_set(results, styles)["own frames"]
    seen: dict[str, set[str]] = {}
    for figure in figures.values():
        for artist in figure.findobj(lambda artist: hasattr(artist, "get_facecolor")):
            for mark in figure.marks.get(artist.get_gid(), ()):
                colour = np.atleast_2d(artist.get_facecolor())[0][:3]
                seen.setdefault(mark.model, set()).add(to_hex(colour).upper())
    assert len(figures) == 4
    assert seen == {f"M{index}": {MODEL_STYLES[7 - index].colour.upper()} for index in range(5)}


@pytest.mark.parametrize("draw", [clean_against_cre, effective_trend, relations, crer_by_family])
def test_wide_intervals_do_not_push_the_values_of_a_figure_together(draw):
    lines = _own(*5 * ["UNKNOWN"], weather=True)
    narrow = draw(lines)
    figure = draw(_changed(lines, lambda _, row: {"low": 0.001, "high": 900.0 * row["value"]}))
    assert "95 %" in figure.caption
    for panel, other in zip(figure.axes, narrow.axes, strict=True):
        for axis in ("xaxis", "yaxis"):
            shown, before = (
                getattr(one, axis).get_transform().transform(getattr(one, axis).get_view_interval())
                for one in (panel, other)
            )
            assert np.ptp(shown) < 7 * np.ptp(before)


def test_severity_curves_have_a_line_per_run_and_a_band():
    figure = severity_curves({"a": _curves(_rows(1)), "b": _curves(_rows(2))})
    fog = figure.axes[0]
    assert fog.get_title() == "Fog"
    assert [list(line.get_xdata()) for line in fog.lines] == [[1, 3], [1, 3]]
    expected = _rows(1).filter(corruption="fog", severity=3)["rcre_sum"].mean() / 1000
    assert fog.lines[0].get_ydata()[1] == pytest.approx(expected)
    assert (len(fog.collections), "95 %" in figure.caption) == (2, True)
    alone = severity_curves({"a": _curves(_rows(count=1))})
    assert (len(alone.axes[0].collections), "95 %" in alone.caption) == (0, False)
    ((_, top),) = {axes.get_ylim() for axes in figure.axes}
    scale_panels(figure, apart=True)
    assert len({axes.get_ylim() for axes in figure.axes}) > 1
    assert max(axes.get_ylim()[1] for axes in figure.axes) == top
    long = severity_curves({f"model with a long name {index}": _curves(_rows(index)) for index in range(7)}, "epe")
    long.draw_without_rendering()
    box = long.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= long.bbox.x1


@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_with_markup_are_drawn_as_text():
    ((key, made),) = _own("OOD", weather=True).items()
    results = {key._replace(model=name): made for name in HOSTILE}
    curves = _curves(_rows(count=3))
    figures = [clean_against_cre(results)]
    for part in (HOSTILE[:8], HOSTILE[8:]):
        of_part = {key: line for key, line in results.items() if key.model in part}
        figures += [crer_by_family(of_part), severity_curves(dict.fromkeys(part, curves))]
    for figure in figures:
        ElementTree.fromstring(figure_bytes(figure, "svg"))
    shown = _texts(figures[0])
    assert "<img src=x onerror=alert(1)> 1.50" in shown
    assert "\x1b" not in shown


def test_files_open_and_are_the_same_every_time(tmp_path):
    results = _own("OOD", "OOD", weather=True)
    paths = write_figures({"a": crer_by_family(results)}, tmp_path / "figures")
    assert [path.suffix[1:] for path in paths] == list(FILE_FORMATS)
    assert cv2.imread(str(paths[0])).shape[1] == 1000  # 5 inches at 200 dots per inch
    assert ElementTree.parse(paths[1]).getroot().tag.endswith("svg")
    assert paths[2].read_bytes().startswith(b"%PDF-")
    for path in paths:
        assert path.read_bytes() == figure_bytes(crer_by_family(results), path.suffix[1:])


def test_figures_without_data_are_left_out_and_sample_sets_are_numbered():
    """A run that has curves but no means; the first of two sets has no ground truth; a single set has no number."""
    of_means = {"clean_against_cre", "crer_by_family", "relations", "effective_trend"}
    run = {LineKey("kitti-fc", "UNKNOWN", "OOD", "a"): _run(_rows())}
    assert set(all_figures({**published_lines(), **run})) == of_means | {"severity_rcre_1", "severity_epe_1"}
    assert not all_figures({})
    own = _changed(_own("OOD", "OOD"), lambda *_: {"source": "measured"})
    kitti = {key: Numbers(line | _run(_rows(index))) for index, (key, line) in enumerate(own.items())}
    assert set(all_figures(kitti)) == {"clean_against_cre", "severity_rcre", "severity_epe"}
    curves = {f"severity_{metric}_{number}" for metric in ("rcre", "epe") for number in (1, 2)}
    clip = {LineKey("gopro-fc", "clip", "OOD", "a"): _run(_rows())}
    assert set(all_figures(clip | kitti)) == {"clean_against_cre_2"} | curves
    unknown = {key._replace(benchmark="folder"): line for key, line in _own("OOD", "UNKNOWN").items()}
    assert not figures_by_sample_set(unknown)


def test_own_models_on_the_same_frames_are_drawn_together():
    """Five models in four settings give one panel; FlowDiffuser, which the paper does not discuss, is one of them. A
    model in two settings has a panel for each."""
    lines = _own("knowledge", "OOD", "ID", "UNKNOWN", "UNKNOWN")
    results = _renamed(lines, lambda name: name.replace("M1", "FlowDiffuser"))
    drawn = figures_by_sample_set(results)["own frames"]
    for name in ("clean_against_cre", "relations"):
        shown = {(mark.model, mark.setting) for marks in drawn[name].marks.values() for mark in marks}
        unknown = {("M3", "UNKNOWN"), ("M4", "UNKNOWN")}
        assert shown == {("M0", "knowledge"), ("FlowDiffuser", "OOD"), ("M2", "ID"), *unknown}
    assert len(drawn["clean_against_cre"].axes) == len(drawn["effective_trend"].axes) == 1
    assert drawn["relations"].axes[0].get_title(loc="left").startswith("(a) r = 1.00")
    results = _renamed(_own("OOD", "ID"), lambda _: "M")
    assert len(figures_by_sample_set(results)["own frames"]["clean_against_cre"].axes) == 2


def test_names_of_points_never_overlap():
    (axes,) = new_figure(3, 3)[1]
    places = np.random.default_rng(0).normal(1, 0.02, (30, 2))
    axes.set(xlim=(0, 2), ylim=(0, 2))
    texts = spread_labels(axes, [(x, y, "a model's name 1.00") for x, y in places], [4.0] * 30)
    boxes = [text.get_window_extent() for text in texts if text.get_visible()]
    assert len(boxes) > 3
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
