"""The guides' own examples, run as a reader would."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

import robustflow as rf
from robustflow.cli.main import main
from robustflow.images.io import write_image
from tests.video import clips

DOCS = Path(__file__).resolve().parent.parent / "docs"


def sections():
    """The guide 'add your model': the model itself, modules, exported networks, clips."""
    first, module, exported, clip = re.split(r"^## .*$", (DOCS / "add-your-model.md").read_text(), flags=re.MULTILINE)
    return first, module, exported, clip


def test_add_your_model(tmp_path, monkeypatch, capsys):
    page, _, _, _ = sections()
    module, script = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (command,) = re.findall(r"```\n(robustflow run .*?)\n```", page)
    (tmp_path / "my_model.py").write_text(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    monkeypatch.setattr(sys, "argv", [*shlex.split(command), "--output", "run"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code in (0, None)
    assert "contrast" in capsys.readouterr().out
    model = rf.Result("run").manifest["identity"]["model"]
    assert model["options"] == {"blur": "2.0"}

    exec(compile(script, "add-your-model.md", "exec"), {})
    assert float(capsys.readouterr().out) > -1


@pytest.mark.torch
def test_a_pytorch_module(tmp_path, monkeypatch, capsys):
    pytest.importorskip("torch", reason="needs the torch extra")
    _, section, _, _ = sections()
    module, script = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (command,) = re.findall(r"```\n(robustflow run .*?)\n```", section)
    (tmp_path / "my_network.py").write_text(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    exec(compile(script, "add-your-model.md", "exec"), {})
    assert capsys.readouterr().out.startswith("Mine ")
    declared = rf.Result("runs/my_network").manifest
    monkeypatch.setattr(sys, "argv", [*shlex.split(command), "--severities", "3", "--no-examples", "--output", "run"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code in (0, None), capsys.readouterr().err
    run = rf.Result("run").manifest
    for manifest in (declared, run):
        assert manifest["provenance"]["trained_on"] == ["flyingchairs", "flyingthings3d"]
        assert manifest["identity"]["model"]["input"]["scale"] == 2 / 255
        assert manifest["identity"]["model"]["layout"] == "pair"


@pytest.mark.torch
@pytest.mark.filterwarnings("ignore")  # of the exporters, about what they will do one day
def test_an_exported_network(tmp_path, monkeypatch, capsys):
    for library in ("torch", "onnx", "onnxruntime"):
        pytest.importorskip(library, reason=f"needs {library}")
    _, _, section, _ = sections()
    (script,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (commands,) = re.findall(r"```\n(robustflow run .*?)\n```", section, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    namespace = {}
    exec(compile(script, "add-your-model.md", "exec"), namespace)
    runs = []
    for i, command in enumerate(commands.splitlines()):
        monkeypatch.setattr(sys, "argv", [*shlex.split(command), "--severities", "3", "--output", f"run{i}"])
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code in (0, None), capsys.readouterr().err
        runs.append(rf.Result(f"run{i}"))
    onnx, exported = runs
    assert [run.manifest["identity"]["model"]["input"]["scale"] for run in runs] == [2 / 255] * 2
    assert onnx.epe_clean == pytest.approx(exported.epe_clean, abs=1e-4)
    assert onnx.crer == pytest.approx(exported.crer, abs=1e-4)


def test_add_your_corruption(tmp_path, monkeypatch, capsys):
    page = (DOCS / "add-your-corruption.md").read_text()
    module, script = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (commands,) = re.findall(r"```\n(robustflow corrupt .*?)\n```", page, re.DOTALL)
    (tmp_path / "my_weather.py").write_text(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("frame1.png", "frame2.png"):
        write_image(tmp_path / name, np.full((48, 64, 3), 90, np.uint8))
    for command in commands.splitlines():
        monkeypatch.setattr(sys, "argv", shlex.split(command))
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code in (0, None), capsys.readouterr().err
    run = rf.load_run("runs/rain")
    assert set(run.rows["corruption"]) == {"clean", "rain", "fog+rain"}
    exec(compile(script, "add-your-corruption.md", "exec"), {})
    assert float(capsys.readouterr().out.splitlines()[-1]) > -1


def test_records(tmp_path, monkeypatch, capsys):
    page = (DOCS / "records.md").read_text()
    monkeypatch.chdir(tmp_path)
    (commands,) = re.findall(r"```\n(robustflow run .*?)\n```", page, re.DOTALL)
    for command in commands.splitlines():
        monkeypatch.setattr(sys, "argv", shlex.split(command))
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code in (0, None), command
    assert "0 findings" in capsys.readouterr().out
    assert rf.load_run("mine.robustflow").summary == rf.Result("mine").summary


def test_a_multi_frame_model(tmp_path, monkeypatch, capsys):
    _, _, _, section = sections()
    (module,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (command,) = re.findall(r"```\n(robustflow run .*?)\n```", section)
    (tmp_path / "my_clip_model.py").write_text(module)
    clips.clip(tmp_path / "clip.mp4", 4, fps=25)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "argv", [*shlex.split(command), "--output", "run"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code in (0, None)
    assert "contrast" in capsys.readouterr().out
    result = rf.Result("run")
    assert result.manifest["identity"]["window"] == {"before": 1, "after": 1, "ends": "repeat"}
    assert result.summary.complete


def test_add_your_dataset(tmp_path, monkeypatch, capsys):
    page = (DOCS / "add-your-dataset.md").read_text()
    module, check, benchmark = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    commands = re.findall(r"```\n(robustflow run .*?)\n```", page)
    (tmp_path / "my_data.py").write_text(module + "\n\n" + benchmark)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    exec(compile(check, "add-your-dataset.md", "exec"), {})
    assert capsys.readouterr().out == "shifted\n"
    for number, command in enumerate(commands):
        monkeypatch.setattr(sys, "argv", [*shlex.split(command), "--no-examples", "--output", f"run{number}"])
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code in (0, None)
    identity, haze = (rf.load_run(f"run{number}").manifest["identity"] for number in (0, 1))
    assert (identity["benchmark"], identity["protocol"]["options"]) == ("shifted", {"size": "80"})
    assert identity["protocol"]["own"]["dataset"] == "my_data:Shifted"
    assert (haze["benchmark"], haze["dataset"]) == ("haze", "shifted")
    assert set(rf.load_run("run1").summary.corruptions) == {"fog", "contrast"}
