"""Test the documentation's sources: the reference has every public name, pages are generated from the code, and
notebooks run.
"""

import ast
import json
import re
import shlex

import pytest
import skimage
import typer

from robustflow.cli.main import app
from robustflow.corruptions import FAMILIES
from robustflow.corruptions.registry import SHIPPED
from robustflow.corruptions.weather.frost_photographs import FOLDER_VARIABLE
from robustflow.stats.published.tables import published_frame

from .guide_blocks import DOCS, blocks
from .public_surface import surface

ROOT = DOCS.parent
SOURCES = (ROOT, ROOT / "src", ROOT / "src" / "robustflow")
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
NAVIGATION = (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2]


@pytest.fixture
def generated(monkeypatch):
    """Make docs/hooks/generated/ importable."""
    monkeypatch.syspath_prepend(DOCS / "hooks")

    def module(name):
        return __import__(f"generated.{name}", fromlist=["files"])

    return module


def test_the_reference_names_everything_public():
    documented = {
        name for page in ("python", "testing") for name in re.findall(r"^::: (\S+)", _page(page), re.MULTILINE)
    }
    names = {line.partition("(")[0] for line in surface() if not line.startswith("robustflow ") and "." in line}
    whole = {name for name in names if not any(name.startswith(f"{other}.") for other in names)}
    assert not sorted(whole - documented)
    assert not sorted(name for name in documented - whole if ".errors." not in name and "TorchModel" not in name)


def _page(name):
    return (DOCS / "reference" / f"{name}.md").read_text()


def test_every_page_is_in_the_navigation():
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert not sorted(page for page in pages if not re.search(rf"[:-] {re.escape(page)}$", NAVIGATION, re.MULTILINE))


def test_every_source_file_that_a_page_names_exists():
    texts = {path: path.read_text() for path in [*DOCS.rglob("*.md"), *ROOT.glob("*.md")]}
    named = {(path.name, file) for path, text in texts.items() for file in re.findall(r"`(\w+/[\w/]+\.py)\b", text)}
    assert named
    assert not [each for each in named if not any((top / each[1]).is_file() for top in SOURCES)]


def test_every_link_of_a_committed_page_leads_to_a_committed_file():
    links = [
        (path, target)
        for path in [*DOCS.rglob("*.md"), *ROOT.glob("*.md")]
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", path.read_text())
    ]
    assert len(links) > 50
    assert not [f"{path.name}: {target}" for path, target in links if not (path.parent / target).exists()]


def test_bold_text_begins_with_two_asterisks_not_three():
    """Three asterisks open an emphasis that two do not close, so one asterisk is printed."""
    texts = {path: path.read_text() for path in [*DOCS.rglob("*.md"), *ROOT.glob("*.md")]}
    assert not [f"{path.name}: {found}" for path, text in texts.items() for found in re.findall(r"\*{3}.{20}", text)]


def test_every_command_and_option_has_its_line(generated):
    pages = generated("commands").files()
    missing = []
    for line in surface():
        if not line.startswith("robustflow "):
            continue
        words = line.split()[1:]
        option = words.pop() if words[-1].startswith(("-", "<")) else ""
        page = pages.get(f"reference/cli/{'-'.join(words) or 'index'}.md")
        if page is not None and option and not option.startswith("<"):
            missing += [line] if f"`{option}`" not in page else []
        elif page is None and not any(path.startswith(f"reference/cli/{words[0]}-") for path in pages):
            missing.append(line)
    assert not missing


def test_every_example_of_the_command_line_is_a_command(generated):
    """The commands are parsed but not run: names of commands and options, and values of their types."""
    commands = dict(generated("commands").commands())
    examples = [
        (path, line)
        for path, command in commands.items()
        for line in generated("commands")._text(command.help)[1]
        if line.startswith("robustflow ")
    ]
    assert len(examples) > 50
    for path, line in examples:
        words = shlex.split(line.partition("&&")[0])[1:]
        if path == "reproduce table":  # `table` may be omitted
            words.insert(1, "table")
        assert words[: len(path.split())] == path.split(), line
        commands[path].make_context(path, words[len(path.split()) :])


def test_a_page_for_each_corruption_has_notes_and_runs(generated, tmp_path, monkeypatch):
    notes = generated("corruption_notes").NOTES
    assert set(notes) == set(SHIPPED)
    pages = generated("corruptions")
    for name in SHIPPED:
        parameters = pages.load_corruption(name).severities
        count = len(parameters[0]) if isinstance(parameters[0], tuple) else 1
        assert len(notes[name].parameters) == count, name
        if name in ("contrast", "fog", "snow", "impulse_noise", "gaussian_blur"):
            _, script = blocks(pages._use(name))
            exec(compile(script.code, name, "exec"), {})


def test_a_page_for_each_family_has_its_means(generated):
    families, numbers = generated("families"), generated("demonstration").Numbers
    assert set(families.ABOUT) == set(FAMILIES)
    for family, names in FAMILIES.items():
        page = families.page(
            family, {name: numbers((1.0, 2.0, 3.0, 4.0, place), 0.5) for place, name in enumerate(names)}
        )
        assert all(f"(../{name}.md)" in page and f"{name}_3.webp" in page for name in names)
    digital = families.page("digital", {name: numbers((1, 2, 3, 4, place), 0.5) for place, name in enumerate("abcd")})
    assert "| **mean** | 1.00 | 2.00 | 3.00 | 4.00 | 1.50 | 2.30 |" in digital
    blur = families.page("blur", {name: numbers((1, 1, 1, 1, 1), 0.5) for name in FAMILIES["blur"]})
    assert blur.count("| **mean** |") == 1  # object_motion_blur is measured on a clip; its table has no mean
    weather = families.page("weather", dict.fromkeys(FAMILIES["weather"], numbers((1, 1, 1, 1, 1), 0.5)))
    published = published_frame().filter(measure="cre", setting="OOD", model="RAFT", benchmark="kitti-fc")
    values = [published.filter(condition=name)["value"].item() for name in ("spatter", "fog", "frost", "snow")]
    assert f"| RAFT | OOD | {sum(values) / 4:.2f} |" in weather
    assert weather.count(" | ID | ") + weather.count(" | OOD | ") + weather.count(" | knowledge | ") == 29


@pytest.mark.parametrize("name", ["contrast", "frost"])
def test_figures_of_the_corruption_pages_equal_a_run(generated, small_demo, tmp_path, monkeypatch, name):
    import robustflow as rf

    monkeypatch.setattr(skimage, "__file__", small_demo)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))  # an empty folder: neither uses photographs of frost
    (cell,) = [cell for cell in generated("demonstration").seen(name) if cell.severity == 5]
    run = rf.evaluate("dis", corruptions=[name], severities=[5], output=tmp_path, progress=False)
    assert (cell.epe, cell.epe_clean, cell.rcre) == pytest.approx((run.epe, run.epe_clean, run.rcre), rel=1e-9)


def test_formats_name_every_field(generated):
    from robustflow.metrics import METRICS
    from robustflow.metrics.rows import ROW_SCHEMA
    from robustflow.run.identity import Identity
    from robustflow.run.records.format import Manifest, Record
    from robustflow.run.summary import Measured

    pages = generated("formats").files()
    assert all(f"| `{name}` |" in pages["reference/rows.md"] for name in ROW_SCHEMA)
    assert all(f"| `{name}` |" in pages["reference/summary.md"] for name in METRICS)
    for model, page in ((Measured, "summary"), (Record, "record"), (Manifest, "manifest"), (Identity, "manifest")):
        names = [field.alias or name for name, field in model.model_fields.items()]
        assert all(f"| `{name}` |" in pages[f"reference/{page}.md"] for name in names)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_notebook_has_output_in_order(notebook):
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert not [output for cell in cells for output in cell["outputs"] if output["output_type"] == "error"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_gives_its_stored_output(notebook, tmp_path, monkeypatch, capsys):
    """Running the cells as in Jupyter reproduces their stored output."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", plt.close)
    names: dict[str, object] = {"__name__": "__main__"}
    for cell in json.loads(notebook.read_text())["cells"]:
        if cell["cell_type"] == "code":
            value = _value_of("".join(cell["source"]), names)
            for output in cell["outputs"]:
                if output["output_type"] == "stream":
                    assert capsys.readouterr().out == "".join(output["text"])
                elif output["output_type"] == "execute_result" and "image/png" not in output["data"]:
                    assert repr(value).split() == "".join(output["data"]["text/plain"]).split()


def _value_of(source, names):
    """Run a cell; return the value of its last line if that is an expression."""
    *before, last = ast.parse(source).body
    exec(compile(ast.Module(before, []), "cell", "exec"), names)
    if isinstance(last, ast.Expr):
        return eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    exec(compile(ast.Module([last], []), "cell", "exec"), names)
    return None


def test_options_of_typer_have_the_type_that_pages_read():
    """Pages of commands read typer's internal objects; if those change, the pages would be empty."""
    run = typer.main.get_command(app).commands["run"]
    assert any(option.type_descriptor.annotation for option in run.params)
