"""Run the documentation's examples as a reader would."""

import sys

import pytest
import skimage

import robustflow as rf

from .guide_blocks import DOCS, RUNNABLE, Reader, blocks, pages

OWN_TESTS = {"add-your-model.md", "add-your-corruption.md", "add-your-attack.md", "add-your-dataset.md", "records.md"}
"""Pages whose results are checked below."""
SLOW = {"tutorials/first-run.md"}


@pytest.fixture
def reader(tmp_path, monkeypatch, capsys, small_demo):
    """A reader whose demo pair is small."""
    monkeypatch.setattr(skimage, "__file__", small_demo)
    before = set(sys.modules)
    yield Reader(tmp_path, monkeypatch, capsys)
    for name in set(sys.modules) - before:  # the reader's own files
        if name.startswith("my_"):
            del sys.modules[name]


@pytest.mark.parametrize("page", pages())
def test_every_block_is_run_or_says_why_not(page):
    for block in blocks((DOCS / page).read_text()):
        assert not block.hidden_command, f"```bash before: {block.code[:60]}"
        assert not (block.mark.startswith("not run") and not block.why_not), "say why"


def _pages_with_blocks():
    runnable = [p for p in pages() if p not in OWN_TESTS and any(b.runs for b in blocks((DOCS / p).read_text()))]
    return [pytest.param(page, marks=[pytest.mark.slow] if page in SLOW else []) for page in runnable]


@pytest.mark.parametrize("page", _pages_with_blocks())
def test_code_of_a_page_runs(page, reader):
    reader.follow(page)


@pytest.mark.torch
def test_pages_that_need_torch(reader):
    pytest.importorskip("torch", reason="needs the torch extra")
    for page in pages():
        if page not in OWN_TESTS:
            reader.follow(page, torch=True)


def test_add_your_model(reader):
    reader.follow("add-your-model.md")
    first, clip = (rf.Result(folder) for folder in reader.runs)
    assert first.manifest.identity.model.settings["options"] == {"blur": "2.0"}
    assert "contrast" in reader.printed[0]
    assert float(reader.printed[1]) > -1
    assert clip.manifest.identity.model.window == {"before": 1, "after": 1, "ends": "repeat"}
    assert clip.measured.complete


@pytest.mark.torch
@pytest.mark.filterwarnings("ignore")  # the exporters' warnings about future versions
def test_add_your_model_with_torch(reader):
    for library in ("torch", "onnx", "onnxruntime"):
        pytest.importorskip(library, reason=f"needs {library}")
    reader.follow("add-your-model.md", torch=True)
    assert reader.printed[0].startswith("Mine ")
    declared, named = rf.Result("runs/my_network").manifest, rf.Result(reader.runs[0]).manifest
    for manifest in (declared, named):
        assert manifest.provenance.trained_on == ("flyingchairs", "flyingthings3d")
        assert manifest.identity.model.settings["input"]["scale"] == 2 / 255
        assert manifest.identity.model.settings["layout"] == "pair"
    (onnx,) = (rf.Result(folder) for folder in reader.runs[1:])
    assert onnx.manifest.identity.model.settings["input"]["scale"] == 2 / 255
    assert onnx.measured.complete


def test_add_your_corruption(reader):
    reader.follow("add-your-corruption.md")
    assert set(rf.load_run("runs/rain").rows["corruption"]) == {"clean", "rain", "fog+rain"}
    assert float(reader.printed[-2].splitlines()[-1]) > -1
    assert set(rf.load_run("runs/dusk").rows["corruption"]) == {"clean", "dusk"}


def test_add_your_attack(reader):
    reader.follow("add-your-attack.md")
    rows = rf.load_run("runs/flicker").attack_rows
    assert set(rows["corruption"]) >= {"clean", "random_sign", "flicker:queries=4"}
    assert rows.filter(corruption="flicker:queries=4")["attack_evaluations"].to_list() == [4]
    assert reader.printed[-1].splitlines()[-1] == "2.0"


@pytest.mark.torch
def test_add_your_attack_with_torch(reader):
    pytest.importorskip("torch", reason="needs the torch extra")
    reader.run(blocks((DOCS / "add-your-attack.md").read_text()), "add-your-attack.md")
    assert "attack 'momentum': all checks passed" in "".join(reader.printed)
    assert "momentum:steps=2" in set(rf.load_run("runs/momentum").attack_rows["corruption"])


def test_page_about_records_runs(reader):
    reader.follow("records.md")
    assert any("  verified, SHA-256" in text for text in reader.printed)
    assert rf.load_run("mine.robustflow").means == rf.Result("mine").means


def test_add_your_dataset(reader):
    reader.follow("add-your-dataset.md")
    assert "shifted\n" in reader.printed
    identity, haze = (rf.load_run(folder).manifest.identity.frames for folder in reader.runs)
    assert (identity.benchmark, identity.protocol["options"]) == ("shifted", {"size": "80"})
    assert identity.protocol["own"]["dataset"] == "my_data:Shifted"
    assert (haze.benchmark, haze.dataset) == ("haze", "shifted")
    assert set(rf.load_run(reader.runs[1]).measured.corruptions) == {"fog", "contrast"}


def test_block_of_a_page_is_read_with_its_comment():
    marked = "a\n\n<!-- torch, file: m.py -->\n```python\nx = 1\n```\n\n"
    bare, slow = "```\nrobustflow list\n```\n", "<!-- not run: long -->\n```bash\nb\n```\n"
    first, second, third = blocks(marked + bare + slow)
    assert (first.torch, first.file, first.language, first.runs) == (True, "m.py", "python", True)
    assert second.hidden_command
    assert (third.why_not, third.runs, third.language in RUNNABLE) == ("long", False, True)
