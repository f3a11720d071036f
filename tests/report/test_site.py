"""A page shows results together only if they were measured on the same frames, and is one safe and complete file."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import polars as pl
import pytest
from PIL import Image

from robustflow.api import evaluate
from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets import load_dataset
from robustflow.media.images import read_image
from robustflow.metrics.measures import MEASURES
from robustflow.report.figures import clean_against_cre, relations, severity_curves
from robustflow.report.figures.canvas import new_figure
from robustflow.report.gallery.layout import picture_of_panel
from robustflow.report.notebook import json_block
from robustflow.report.site import page, render_site, run_content, whole_content
from robustflow.report.site.examples import examples_of
from robustflow.report.site.figures import page_figures, page_styles
from robustflow.report.site.headline import headline_of
from robustflow.report.site.models import model_pages
from robustflow.report.site.svg import inline_svg
from robustflow.run.run import Run
from robustflow.run.trust import DERIVED
from robustflow.stats.estimate import cubes_of, estimate
from robustflow.stats.lines import Numbers
from robustflow.stats.published.tables import published_frame, published_lines
from robustflow.stats.results import RESULT_METRICS, long_label
from robustflow.stats.results_file import parse_results, results_csv
from robustflow.testing import ConstantFlow
from tests.made_rows import made_run

from ..refusals import refusal
from ..stats.simulated import Truth, rows_of
from .elements import Elements
from .hostile import HOSTILE

_HEAD = "setting,model,metric,corruption,value,sample_set\n"
_KITTI = {key: line for key, line in published_lines().items() if key.benchmark == "kitti-fc"}


def _file(text: str):
    return parse_results(_HEAD + text, "mine.csv", "file")


def _own(*files, runs=()):
    return whole_content(runs, [(f"{index}.csv", _file(text)) for index, text in enumerate(files)], published=False)


def test_runs_files_and_the_paper_are_separate_groups(small_run):
    one, two = _file("OOD,A,epe,average,1.00,\n"), _file("OOD,A,epe,average,2.00,\n")
    content = whole_content([small_run], [("one.csv", one), ("two.csv", two)])
    boards = {board.name: board for board in content.boards}
    sources = [
        {content.lines[line.result].fact("source") for line in section.lines} for section in boards["kitti-fc"].sections
    ]
    assert sources == [{"published"}, {"claimed"}, {"claimed"}]
    assert [section.title for section in boards["kitti-fc"].sections][1:] == ["Claimed: one.csv", "Claimed: two.csv"]
    written = _own("OOD,A,epe,average,1.00,\n").frame
    again = parse_results(results_csv(written), "results.csv", "file")
    (board,) = whole_content([], [("b.csv", two), ("results.csv", again)], published=False).boards
    assert len(board.sections) == 2, "a file written from a leaderboard stays apart from other files"


def test_benchmarks_are_ordered_by_their_number_of_runs_then_of_models(small_run, many_images):
    orders = [[], [small_run], [small_run, many_images("A"), many_images("Bb")]]
    assert [[board.name for board in whole_content(runs).boards] for runs in orders] == [
        ["kitti-fc", "gopro-fc"],
        ["demo", "kitti-fc", "gopro-fc"],
        ["kitti-fc", "demo", "gopro-fc"],
    ]


def test_value_given_twice_and_page_without_results_are_refused():
    results = _file("OOD,RAFT,epe,clean,1.00,mine\n")
    refusal(lambda: whole_content([], [("one.csv", results), ("two.csv", results)]), DataError, "RAFT")
    with pytest.raises(UsageError):
        _own("")


def test_a_page_about_a_run_leaves_the_paper_in_the_background(small_run):
    content = run_content(small_run)
    assert [content.runs[key] for key in content.focus] == [small_run]
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
    board = run_content(run).boards[0]
    assert (board.name, [column.label for column in board.columns]) == ("demo", ["Coverage"])
    assert [(line.label, [cell.text for cell in line.cells]) for line in board.lines] == [("blind", ["0.00"])]
    text = (run.path / "report.html").read_text()
    assert "NaN" in text
    assert 'id="primary" data-page="blind"' in text


def test_page_of_a_model_shows_corruptions_that_the_paper_does_not_have():
    errors = {"fog": 2, "brightness": 9, "elastic_transform": 1, "average": 4}
    content = _own("".join(f"OOD,A,rcre,{name},{value}.00,\n" for name, value in errors.items()))
    ((_, tables),) = model_pages(content).values()
    (table,) = (one for one in tables if one.name == "shaded")
    cells = {line.label: [cell.text for cell in line.cells] for line in table.lines}
    assert cells == {"Fog": ["2.00"], "Brightness": ["9.00"], "Elastic transform": ["1.00"], "Average": ["4.00"]}
    assert table.columns[0].strongest == 9.0


def test_many_runs_have_intervals_of_averages_only_and_release_their_rows(tmp_path, monkeypatch):
    chosen = {"corruptions": ["contrast"], "severities": [1]}
    folders = [evaluate("dis", "demo", output=tmp_path / f"{seed}", seed=seed, **chosen).path for seed in (0, 1)]
    for folder in folders:
        (folder / DERIVED).unlink(missing_ok=True)
    asked = []

    def counted(cube, measures, scopes):
        asked.append(len(scopes))
        return estimate(cube, measures, scopes)

    monkeypatch.setattr("robustflow.stats.intervals.estimate", counted)
    monkeypatch.setattr("robustflow.report.site.content.MOST_DETAILED", 1)
    runs = [Run(folder) for folder in folders]
    whole_content(runs, published=False)
    assert asked == [2, 2]  # the clean frames and the average
    assert all("rows" not in vars(run) for run in runs)
    monkeypatch.setattr("robustflow.report.site.content.MOST_DETAILED", 2)
    content = whole_content([Run(folder) for folder in folders], published=False)
    assert content.frame["low"].null_count() == content.frame.height  # a single pair has no intervals
    assert asked == [2, 2, *2 * [2, 7, 1]]  # also corruptions and families, and each severity


@pytest.fixture(scope="module")
def published() -> str:
    return render_site(whole_content([]))


def data_of(text: str) -> dict:
    """The data from which the page's script builds boards and model pages."""
    return next(block for block in Elements(text).data() if "boards" in block)  # the other one belongs to the slider


def _entries(data: dict) -> list[dict]:
    return [line for board in data["boards"] for section in board["sections"] for line in section["lines"]]


def test_page_has_published_rows_figures_and_audit(published):
    shown = {}
    for board in data_of(published)["boards"]:
        for entry in (line for section in board["sections"] for line in section["lines"]):
            texts = entry["texts"].split("\t")
            for index, metric, condition in board["exported"]:
                shown[board["name"], entry["setting"], entry["name"], metric, condition] = texts[index]
    for row in published_frame().filter(pl.col("measure").is_in(RESULT_METRICS)).iter_rows(named=True):
        key = [row[name] for name in ("benchmark", "setting", "model", "measure", "condition")]
        assert shown[tuple(key)] == f"{row['value']:.2f}"
    assert [published.count(f"{counts} compared numbers") for counts in ("119 of 2748", "0 of 36")] == [1, 1]
    assert published.count('class="plot"') == 4
    assert published.count('class="chart"') == 2 + 3 + 4 + 2


def test_nothing_but_the_pages_own_script_may_run(published):
    elements = Elements(published)
    policy = next(a["content"] for a in elements.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    (running,) = (body for attrs, body in elements.scripts if "type" not in attrs)
    digest = base64.b64encode(hashlib.sha256(running.encode()).digest()).decode()
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline'; ")
    assert f"script-src 'sha256-{digest}';" in policy
    assert not any(name.startswith("on") for _, attrs in elements.found for name in attrs)
    for tag, attrs in elements.found:
        for name in ("src", "href", "action", "data"):
            address = attrs.get(name)
            assert address is None or address.startswith(("#", "data:image/jpeg;base64,")), (tag, address)
    assert "url(" not in re.sub(r"url\(#[a-z0-9-]+\)", "", published)


def test_ids_are_unique_and_every_reference_has_its_target(published):
    elements = Elements(published)
    ids = [attrs["id"] for _, attrs in elements.found if "id" in attrs]
    assert len(ids) == len(set(ids))
    used = {attrs["href"][1:] for _, attrs in elements.found if (attrs.get("href") or "").startswith("#")}
    used |= set(re.findall(r"url\(#([^)]*)\)", published))
    described = (attrs.get(f"aria-{kind}by", "") for _, attrs in elements.found for kind in ("labelled", "described"))
    used |= {name for names in described for name in names.split()}
    assert used <= set(ids)
    data = data_of(published)
    marks = set(re.findall(r'data-page="([a-z0-9-]*)"', published))
    assert {entry["page"] for entry in _entries(data)} == set(data["models"]) >= marks
    assert len(data["models"]) == 17


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.filterwarnings("ignore:Matplotlib currently does not support")
def test_hostile_names_are_text(published):
    cells = (
        ("epe", "clean", 2),
        ("epe", "average", 5),
        ("epe", "fog", 4),
        ("cre", "average", 3),
        ("rcre", "average", 4),
    )
    made = _file("".join(f"OOD,A,{metric},{corruption},{value},\n" for metric, corruption, value in cells))
    names = [name for name in HOSTILE if name]
    hostile_settings = (names[0], names[3], "`code` **b** ~~s~~ $$m$$")  # each setting is a panel in two figures
    settings = {name: name if name in hostile_settings else "OOD" for name in names}
    files = [made.with_columns(model=pl.lit(n), note=pl.lit(n), setting=pl.lit(of)) for n, of in settings.items()]
    text = render_site(whole_content([], [(names[0], pl.concat(files))], published=False))
    elements, plain = Elements(text), Elements(published)
    assert {tag for tag, _ in elements.found} <= {tag for tag, _ in plain.found} | {"sup"}
    known = {name for _, attrs in plain.found for name in attrs}
    assert {name for _, attrs in elements.found for name in attrs} <= known
    assert [attrs for attrs, _ in elements.scripts] == [attrs for attrs, _ in plain.scripts]
    assert "<img src=x onerror=alert(1)>" in "".join(elements.texts)  # in the table of a figure
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)
    data = data_of(text)
    assert "<img src=x onerror=alert(1)>" in {entry["name"] for entry in _entries(data)}
    assert data["models"]
    assert all(re.fullmatch("[a-z0-9-]+", slug) for slug in data["models"])


def test_json_cannot_end_its_element():
    block = json_block(["</script><script>alert(1)</script>", "\u2028", "<!--"])
    assert "<" not in block
    assert json.loads(block) == ["</script><script>alert(1)</script>", "\u2028", "<!--"]


def test_headline_of_a_run_names_its_worst_condition_and_shows_its_frame_flow_and_error(tmp_path, real_pictures):
    with real_pictures():
        small_run = evaluate("dis", output=tmp_path, corruptions=["contrast", "fog"], severities=[1, 5], examples=True)
    content = run_content(small_run)
    headline = headline_of(content, content.boards[0], examples_of(content.runs).panels)
    values = {(c, s): small_run.mean("epe", c, s) for c in ("contrast", "fog") for s in (1, 5)}
    worst = max(values, key=values.get)
    assert f"{small_run.epe_clean:.2f} px on the clean frames and {small_run.epe:.2f} px under" in headline.sentence
    assert headline.sentence.endswith(f"highest for {worst[0]} at severity {worst[1]}: {values[worst]:.2f} px.")
    assert len({address for _, address in headline.strip}) == 4
    panel = read_image(small_run.path / "examples" / "worst.jpg")
    clean, corrupted, flow = (picture_of_panel(panel, place, 4) for place in (0, 2, 5))
    pair = load_dataset("motorcycle", None).load("motorcycle")
    size = clean.shape[1], clean.shape[0]
    frame = np.asarray(Image.fromarray(pair.frames[0]).resize(size, Image.Resampling.BOX), float)
    assert np.abs(clean - frame).mean() < 10 < np.abs(corrupted - frame).mean()
    assert clean.shape == corrupted.shape == flow.shape
    assert picture_of_panel(panel[:40], 0, 4) is None


def test_severity_curves_show_the_measure_of_the_headline_and_no_two_models_share_a_colour(many_images):
    content = whole_content(
        [many_images(f"M{index}", 1 + index / 9, seed=index) for index in range(12)], published=False
    )
    (curves,) = (one for group in page_figures(content) for one in group.figures if one.title == "Severity curves")
    assert curves.caption.partition("drawn. ")[2].startswith("EPE")
    colours = {style.colour for style in page_styles(content).styles.values()}
    assert len(colours) == 12


def test_a_comparison_has_a_table_with_a_row_for_each_corruption(many_images):
    runs = [many_images("A"), many_images("Bb", 1.5)]
    text = render_site(whole_content(runs, published=False))
    _, _, rest = text.partition("EPE (px) by corruption")
    for name in runs[0].measured.corruptions:
        assert long_label(name) in rest
        assert all(f"<td>{run.mean('epe', name):.2f}</td>" in rest for run in runs)


def _headline(content) -> str:
    (board,) = content.boards
    return headline_of(content, board, {}).sentence


def test_headline_of_several_runs_names_the_lowest_and_those_that_may_be_as_low(many_images):
    runs = [many_images("A"), many_images("Bb", 1.22, seed=1), many_images("Ccc", 3.0)]
    sentence = _headline(whole_content(runs, published=False))
    first, second = sorted(("A", "Bb"), key=lambda name: next(run.epe for run in runs if run.name == name))
    assert sentence.startswith(f"Of 3 ranked results on KITTI-FC, {first} (")
    assert f"; {second} cannot be told apart from it." in sentence
    assert "Ccc" not in sentence


def test_headline_claims_a_difference_only_from_runs_that_were_tested(many_images, monkeypatch):
    monkeypatch.setattr("robustflow.stats.frame.MOST_COMPARED", 3)
    runs = [many_images("A"), *(many_images(f"B{index}", 3.0, seed=index) for index in range(4))]
    for count, others in ((2, "the others"), (5, "the next 2, the only ones tested")):
        sentence = _headline(whole_content(runs[:count], published=False))
        assert f"this is significantly lower than {others}." in sentence
    runs = [many_images(name, 1 + 1e-9 * index) for index, name in enumerate("ABCD")]
    assert "the only ones tested" not in _headline(whole_content(runs[:3], published=False))
    assert "the next 2, the only ones tested" in _headline(whole_content(runs, published=False))


def test_headline_of_runs_on_different_frames_compares_the_largest_group(many_images, small_run):
    fewer = many_images("A").rows.filter(pl.col("sample") > "00001")
    alone = made_run(small_run, fewer, "Alone", benchmark="kitti-fc")
    sentence = _headline(whole_content([alone, many_images("A")], published=False))
    assert "only" not in sentence
    assert "lowest" not in sentence
    sentence = _headline(whole_content([alone, many_images("A"), many_images("Bb", 3.0)], published=False))
    assert sentence.startswith("Of 2 ranked results on the same frames of KITTI-FC, A (")


def test_headline_without_ground_truth_warns_of_short_flows_and_names_an_averaged_corruption(runs_without_truth):
    one, both = (
        _headline(whole_content(runs, published=False)) for runs in (runs_without_truth[:1], runs_without_truth)
    )
    assert "elastic" not in one
    assert "too short" in one
    assert "too short" in both


def test_headline_of_one_ranked_result_compares_nothing():
    lines = parse_results("setting,model,metric,corruption,value\nOOD,A,epe,average,2.50\n", "few.csv", "file")
    sentence = _headline(whole_content([], [("few.csv", lines)], published=False))
    assert "A (OOD)" in sentence
    assert "2.50 px" in sentence
    assert "lowest" not in sentence


def test_a_report_shows_its_run(small_run):
    text = render_site(run_content(small_run))
    (model,) = (model for model in data_of(text)["models"].values() if model["panels"])
    lines = [line for table in model["tables"] for section in table["sections"] for line in section["lines"]]
    cells = {text for line in lines for text in line["texts"].split("\t")}
    for name in ("contrast", "fog"):
        for key in (("epe", name), ("cre", name), ("rcre", name), ("rcre", name, 1), ("rcre", name, 5)):
            assert f"{small_run.mean(*key):.2f}" in cells
    assert small_run.manifest.identity_digest in cells
    assert text.count("data:image/jpeg;base64,") == 1 + 4 + 2 * 8 + 4
    assert len(re.sub(r"data:image/jpeg;base64,[^\"]*", "", text)) < 5e6
    assert {panel["corruption"] for panel in model["panels"]} <= {line["name"] for line in lines}
    assert text.count('data-scale="figure') == 2, "severity curves with a shared scale and with a scale for each panel"


def test_everything_of_a_benchmark_is_in_its_section(small_run, many_images):
    """A model has one colour in all figures: each colour represents either a kind of model or one model."""
    content = whole_content([small_run, many_images("Mine"), many_images("Other", 1.5)])
    text = render_site(content)
    assert text == render_site(content), "a page is the same every time"
    parts = re.split('<section class="benchmark"', text.partition("</main>")[0])[1:]
    sections = {re.search("<h2[^>]*>([^<]*)</h2>", part)[1]: part.partition("</section>")[0] for part in parts}
    assert list(sections) == ["KITTI-FC", "demo", "GoPro-FC"]
    for name, part in sections.items():
        assert part.count('class="board"') == 1
        assert [other for other in sections if other != name and f"on {other}" in part] == []
        group = r'<details class="figure-group".*?</details>\s*(?=<details class="figure-group"|</div>)'
        for figures in re.findall(group, part, re.DOTALL) or [part]:
            titles = re.findall("<h4 id[^>]*>([^<]*)</h4>", figures)
            assert len(titles) == len(set(titles))
    assert all(words in sections["KITTI-FC"] for words in ("Mine", "Severity curves", "119 of 2748"))
    assert "Mine" not in sections["demo"] + sections["GoPro-FC"]
    meanings: dict[str, set[str]] = {}
    for colour, label in re.findall(r'stroke: (?:var\()?([\w-]+)\)?"></path></svg>([^<]*)</li>', text):
        meanings.setdefault(colour, set()).add(label)
    assert meanings.pop("--muted") == {"OOD", "ID"}
    assert len(meanings) == 6
    assert all(len(labels) == 1 for labels in meanings.values()), meanings


def test_curves_are_drawn_for_the_eight_runs_with_the_lowest_error(many_images):
    """Runs in order from worst to best, so that a page cannot rely on their order."""
    runs = [many_images("m" * index, 1 + 0.1 * index) for index in range(9, 0, -1)]
    (group,) = page_figures(whole_content(runs, published=False))
    (curves,) = (one for one in group.figures if one.title == "Severity curves")
    assert {line.label for line in curves.numbers.lines} == {"m" * index for index in range(1, 9)}
    assert "8 of 9" in curves.caption


@pytest.mark.slow
def test_a_hundred_models_stay_below_the_limit():
    """The values printed for RAFT, a little higher for every model, in three settings."""
    raft = published_frame().filter(benchmark="kitti-fc", setting="ID", model="RAFT")
    models = [
        raft.with_columns(
            pl.col("value") * (1 + 0.01 * index),
            model=pl.lit(f"Model {index:03d}"),
            setting=pl.lit(("OOD", "ID", "UNKNOWN")[index % 3]),
            sample_set=pl.lit("file"),
        )
        for index in range(100)
    ]
    text = render_site(whole_content([], [("many.csv", pl.concat(models))], published=False))
    assert len(data_of(text)["models"]) == 100
    assert len(text.encode()) < 1.5e6


def _svg(figure, prefix="f1"):
    return ElementTree.fromstring(inline_svg(figure, prefix, lambda model: f"page-{model}"))


def _marks(root):
    return [element for element in root.iter() if element.get("class") == "mark"]


def test_every_model_is_a_mark_with_its_numbers_and_the_pages_colours():
    text = inline_svg(clean_against_cre(_KITTI), "f7", lambda model: f"page-{model}")
    marks = _marks(ElementTree.fromstring(text))
    assert len(marks) == 11 + 14
    assert "RAFT (ID): clean EPE 1.81 px, CRE 6.70 px, CREr 3.70" in {mark.get("data-label") for mark in marks}
    assert {mark.get("data-page") for mark in marks} >= {"page-RAFT", "page-ARFlow"}
    assert set(re.findall(r'\bid="(f7-)?', text)) == {"f7-"}
    assert not re.findall(r"#[0-9a-f]{6}|xlink|<style", text)
    clean, corrupted = Truth().draw(np.random.default_rng(0), np.ones(3, int))
    (cube,) = cubes_of({"a": rows_of(clean, corrupted, corrupted)}).values()
    known = estimate(cube, {"rcre": MEASURES["rcre"]}, [at for at in cube.conditions if at[1]]).to_dicts()
    numbers = Numbers(((row["measure"], row["condition"], row["severity"]), row) for row in known)
    curves = _svg(severity_curves({"a": numbers}))
    labels = [mark.get("data-label") for mark in _marks(curves)]
    assert [re.search("severity ([0-9])", text)[1] for text in labels] == ["1", "3", "2"]


def test_panels_of_a_figure_have_one_size_and_contain_their_marks_in_place():
    """Panels are separate elements, so that a page can arrange them in rows; marks are ordered by clean EPE."""
    figure = relations(_KITTI)
    panels = _svg(figure).findall("svg")
    boxes = [list(map(float, panel.get("viewBox").split())) for panel in panels]
    assert len(boxes) == len(figure.axes) == 4
    assert len({(width, height) for _, _, width, height in boxes}) == 1
    for panel, (x, y, width, height) in zip(panels, boxes, strict=True):
        places = [
            (float(mark.get("x")), float(mark.get("y"))) for mark in panel.iter("use") if mark.get("class") == "mark"
        ]
        assert len(places) == 11 + 14
        assert all(x <= at <= x + width and y <= up <= y + height for at, up in places)
    epe = {key.model: line.number("epe", "clean") for key, line in _KITTI.items() if key.setting == "OOD"}
    ood = [mark for mark in _marks(panels[0]) if "(OOD)" in mark.get("data-label")]
    names = [mark.get("data-page").removeprefix("page-") for mark in sorted(ood, key=lambda mark: float(mark.get("x")))]
    assert names == sorted(names, key=epe.__getitem__)
    assert len(names) == 11


@pytest.mark.parametrize(("highest", "shared"), [((3, 3, 3), {"f1-xaxis", "f1-yaxis"}), ((3, 3, 4), {"f1-xaxis"})])
def test_an_axis_is_drawn_once_where_all_panels_have_the_same(highest, shared):
    figure, axes = new_figure(2, 2, 3)
    for panel, high in zip(axes, highest, strict=True):
        panel.set(xlim=(0, 1), ylim=(0, high), xticks=[0, 1], yticks=[0, 2], yticklabels=["low", "two"])
    first, *others = _svg(figure).findall("svg")
    left, top, *_ = map(float, first.get("viewBox").split())
    assert [text.text for text in first.iter("text")] == ["0", "1", "low", "two"]
    for panel in others:
        x, y, *_ = map(float, panel.get("viewBox").split())
        repeated = {one.get("href")[1:]: one.get("transform") for one in panel.iter("use") if one.get("transform")}
        assert repeated.keys() == shared
        for moved in repeated.values():
            assert list(map(float, re.findall(r"-?[\d.]+", moved))) == pytest.approx([x - left, y - top], abs=0.11)
        own = [] if "f1-yaxis" in shared else ["low", "two"]
        assert [text.text for text in panel.iter("text")] == own
    assert all(axis.get_visible() for panel in axes for axis in (panel.xaxis, panel.yaxis)), "as before"


def test_the_page_of_a_run_is_written_again_only_if_its_sources_change(small_run, monkeypatch):
    run = Run(small_run.path)
    page.write_report(run)
    written = (run.path / page.REPORT).stat().st_mtime_ns
    monkeypatch.setattr(page, "render_site", lambda *_: pytest.fail("it is up to date"))
    page.write_report(run)
    assert (run.path / page.REPORT).stat().st_mtime_ns == written
