"""A page is a single complete file, is identical every time it is built, and never treats a name as markup."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html import unescape

import pytest

from robustflow.report.notebook import json_block
from robustflow.report.site.content import run_content, whole_content
from robustflow.report.site.page import render_site
from robustflow.stats.published.tables import published_results
from robustflow.stats.results_file import parse_results

from ..elements import Elements
from ..hostile import HOSTILE

_CELLS = "setting,model,metric,corruption,value\n" + "".join(
    f"OOD,A,{metric},{corruption},{value}\n"
    for metric, corruption, value in (
        ("epe", "clean", 2),
        ("epe", "average", 5),
        ("epe", "fog", 4),
        ("cre", "average", 3),
        ("rcre", "average", 4),
    )
)


@pytest.fixture(scope="module")
def published_page() -> str:
    return render_site(whole_content([]))


def data_of(text: str) -> dict:
    """The data from which the page's script builds rows and model pages."""
    return next(block for block in Elements(text).data() if "boards" in block)  # the other one belongs to the slider


def test_page_has_published_rows_and_audit(published_page):
    text = unescape(re.sub("<[^>]*>", " ", published_page))
    shown = {}
    for board in data_of(published_page)["boards"]:
        for entry in (entry for group in board["groups"] for entry in group):
            for (metric, corruption), value in zip(board["numbers"], entry["values"], strict=False):
                shown[board["benchmark"], entry["setting"], entry["name"], metric, corruption] = value
    for line in published_results():
        for key, value in line.values.items():
            assert shown[line.benchmark, line.setting, line.name, *key] == f"{value.number:.2f}"
    assert text.count("119 of 2748 compared numbers") == 1  # KITTI-FC
    assert text.count("0 of 36 compared numbers") == 1  # GoPro-FC
    assert "the CRE rows of BrightFlow and UPFlow" in text
    assert published_page.count('class="plot"') == 4
    assert published_page.count('class="chart"') == 2 + 3 + 4 + 2


def test_nothing_but_the_pages_own_script_may_run(published_page):
    page = Elements(published_page)
    policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    (running,) = (body for attrs, body in page.scripts if "type" not in attrs)
    digest = base64.b64encode(hashlib.sha256(running.encode()).digest()).decode()
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline'; ")
    assert f"script-src 'sha256-{digest}';" in policy
    assert not any(name.startswith("on") for _, attrs in page.found for name in attrs)
    for tag, attrs in page.found:
        for name in ("src", "href", "action", "data"):
            address = attrs.get(name)
            assert address is None or address.startswith(("#", "data:image/jpeg;base64,")), (tag, address)
    assert "url(" not in re.sub(r"url\(#[a-z0-9-]+\)", "", published_page)


def test_ids_are_unique_and_every_reference_has_its_target(published_page):
    page = Elements(published_page)
    ids = [attrs["id"] for _, attrs in page.found if "id" in attrs]
    assert len(ids) == len(set(ids))
    used = {attrs["href"][1:] for _, attrs in page.found if (attrs.get("href") or "").startswith("#")}
    used |= set(re.findall(r"url\(#([^)]*)\)", published_page))
    described = (attrs.get(f"aria-{kind}by", "") for _, attrs in page.found for kind in ("labelled", "described"))
    used |= {name for names in described for name in names.split()}
    assert used <= set(ids)
    data = data_of(published_page)
    entries = [entry for board in data["boards"] for group in board["groups"] for entry in group]
    marks = set(re.findall(r'data-page="([a-z0-9-]*)"', published_page))
    assert {entry["page"] for entry in entries} == set(data["models"]) >= marks
    assert len(data["models"]) == 17


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.filterwarnings("ignore:Matplotlib currently does not support")
def test_hostile_names_are_text(published_page):
    (made,) = parse_results(_CELLS, "made.csv", "file")
    names = [name for name in HOSTILE if name]
    hostile_settings = (names[0], names[3], "`code` **b** ~~s~~ $$m$$")  # each setting is a panel in two figures
    lines = [replace(made, name=name, setting=name if name in hostile_settings else "OOD", note=name) for name in names]
    text = render_site(whole_content([], [(names[0], lines)], published=False))
    page, plain = Elements(text), Elements(published_page)
    assert {tag for tag, _ in page.found} <= {tag for tag, _ in plain.found}
    assert {name for _, attrs in page.found for name in attrs} <= {name for _, attrs in plain.found for name in attrs}
    assert [attrs for attrs, _ in page.scripts] == [attrs for attrs, _ in plain.scripts]
    assert "<img src=x onerror=alert(1)>" in "".join(page.texts)  # in the table of a figure
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)
    data = data_of(text)
    (entries,) = data["boards"][0]["groups"]
    assert "<img src=x onerror=alert(1)>" in {entry["name"] for entry in entries}
    assert all(re.fullmatch("[a-z0-9-]+", slug) for slug in data["models"])


def test_json_cannot_end_its_element():
    block = json_block(["</script><script>alert(1)</script>", "\u2028", "<!--"])
    assert "<" not in block
    assert json.loads(block) == ["</script><script>alert(1)</script>", "\u2028", "<!--"]


@pytest.fixture(scope="module")
def report(small_run) -> str:
    return render_site(run_content(small_run))


def test_a_report_shows_its_run(small_run, report):
    text = report
    data = data_of(text)
    (model,) = (model for model in data["models"].values() if model["panels"])
    cells = {text for table in model["tables"] for _, texts, *_ in table["lines"] for text in texts.split(" ")}
    for name, levels in small_run.measured.corruptions.items():
        shown = [small_run.mean(metric, name) for metric in ("epe", "cre", "rcre")]
        for value in (*shown, *(small_run.mean("rcre", name, level) for level in levels)):
            assert f"{value:.2f}" in cells
    assert small_run.manifest.identity_digest in text
    assert "Predictions" in text
    assert text.count("data:image/jpeg;base64,") == 1 + 4 + 2
    without_pictures = re.sub(r"data:image/jpeg;base64,[^\"]*", "", text)
    assert len(without_pictures) < 5e6
    for panel, entry in zip(model["panels"], ("worst", "median"), strict=True):
        label, severity = panel["cell"]
        assert panel["title"].lower().startswith(f"{entry} sample: motorcycle, {label.lower()}, severity {severity}")
        assert label in data["labels"]
    # the severity curves, with a shared scale and with a scale for each panel
    assert text.count('data-scale="figure') == 2


def test_the_table_comes_first_but_in_a_report_of_one_run(report, published_page):
    assert published_page.index('id="board-0"') < published_page.index('class="headline"')
    assert report.index('class="headline"') < report.index('id="board-0"')


def _sections(text: str) -> dict[str, str]:
    """Markup of each benchmark's section, by its heading."""
    parts = re.split('<section class="benchmark"', text.partition("</main>")[0])[1:]
    return {re.search("<h2[^>]*>([^<]*)</h2>", part)[1]: part.partition("</section>")[0] for part in parts}


@pytest.fixture(scope="module")
def three_runs_page(small_run, many_images) -> str:
    """A real run and two synthetic ones, together with the published values."""
    return render_site(whole_content([small_run, many_images("Mine"), many_images("Other", 1.5)]))


def test_everything_of_a_benchmark_is_in_its_section(three_runs_page):
    """Each benchmark has one section with its own table, sentences, figures and audit; no heading repeats."""
    sections = _sections(three_runs_page)
    assert list(sections) == ["KITTI-FC", "demo", "GoPro-FC"]
    for name, text in sections.items():
        assert text.count("<table data-start") == 1
        assert [other for other in sections if other != name and f"on {other}" in text] == []
        group = r'<details class="figure-group".*?</details>\s*(?=<details class="figure-group"|</div>)'
        for figures in re.findall(group, text, re.DOTALL) or [text]:
            titles = re.findall("<h4 id[^>]*>([^<]*)</h4>", figures)
            assert len(titles) == len(set(titles))
    assert "Mine" in sections["KITTI-FC"]
    assert "Severity curves" in sections["KITTI-FC"]
    assert "119 of 2748" in sections["KITTI-FC"]
    assert "FlowFormer (OOD, RCRE 1.29 px)" in sections["GoPro-FC"]
    assert "Mine" not in sections["demo"] + sections["GoPro-FC"]


def test_page_mentions_intervals_only_if_it_has_some(small_run, many_images):
    """A run on a single pair has no bands, brackets or whiskers; a run on forty images has all of them."""
    page, again = (render_site(whole_content([small_run], published=False)) for _ in range(2))
    assert page == again, "a page is the same every time"
    (alone,) = _sections(page).values()
    assert "In brackets" not in alone
    assert "confidence intervals." not in alone.replace("No confidence intervals:", "")
    runs = [many_images("A"), many_images("Bb", 1.5)]
    (many,) = _sections(render_site(whole_content(runs, published=False))).values()
    for words in ("In brackets: 95 % confidence intervals", "Whiskers are 95 %", "Bands are 95 %"):
        assert words in many
    assert "fine-tuning" not in alone + many


def test_a_model_has_one_colour_on_a_page(three_runs_page):
    """With two groups of runs and the published values, each colour in a figure represents either a kind of model
    or one model.
    """
    meanings: dict[str, set[str]] = {}
    for colour, label in re.findall(r'stroke: (?:var\()?([\w-]+)\)?"></path></svg>([^<]*)</li>', three_runs_page):
        meanings.setdefault(colour, set()).add(label)
    assert meanings.pop("--muted") == {"OOD", "ID"}
    assert len(meanings) == 6
    assert all(len(labels) == 1 for labels in meanings.values()), meanings


@pytest.mark.slow
def test_a_hundred_models_stay_below_the_limit():
    """The values printed for RAFT, a little higher for every model, in three settings."""
    of_raft = ("kitti-fc", "ID", "RAFT")
    (raft,) = (line for line in published_results() if (line.benchmark, line.setting, line.name) == of_raft)
    models = []
    for index in range(100):
        values = {key: replace(value, number=value.number * (1 + 0.01 * index)) for key, value in raft.values.items()}
        setting = ("OOD", "ID", "own")[index % 3]
        models.append(replace(raft, name=f"Model {index:03d}", setting=setting, frames="file", values=values))
    text = render_site(whole_content([], [("many.csv", models)], published=False))
    assert len(data_of(text)["models"]) == 100
    assert len(text.encode()) < 1.5e6
