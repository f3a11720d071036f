"""An option is declared once: planting one shows that everything else follows from its field."""

import inspect
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import typer.main

import robustflow as rf
from robustflow.cli.main import app
from robustflow.run.config import FIELDS, RunConfig, option_of
from robustflow.run.identity import FrameIdentity, Measuring

SOURCE = Path(rf.__file__).parent
PLANTED = {
    "run/config.py": (
        "    severity_scale: str = option(",
        "    haze: int = option(0, 'Planted option.', words=('haze {}',))\n    severity_scale: str = option(",
    ),
    "api.py": ('    severity_scale: str = "paper",\n', '    severity_scale: str = "paper",\n    haze: int = 0,\n'),
}
"""The edits that add an option of the frames: its field, and the parameter of `evaluate`. The third file uses it."""
SCRIPT = """
import json, sys
import robustflow as rf
from robustflow.cli.main import main
from robustflow.run.comparable import run_facts
few = {"corruptions": ["contrast"], "severities": [1], "examples": False, "progress": False}
plain, hazy = (rf.evaluate("tiny", output=f"run{haze}", haze=haze, **few) for haze in (0, 3))
sys.argv = ["robustflow", "run", "tiny", "--haze", "3", "-c", "contrast", "-s", "1", "-o", "run3", "--no-examples"]
try:
    main()
except SystemExit as stop:
    assert not stop.code
print("\\n" + json.dumps({
    "digests": [run.manifest.identity_digest for run in (plain, hazy)],
    "recorded": hazy.manifest.identity.record()["frames"].get("haze"),
    "absent": "haze" not in plain.manifest.identity.record()["frames"],
    "restored": hazy.manifest.identity.frames.options.haze,
    "words": run_facts([hazy])[0]["haze"],
}))
"""


def test_a_planted_option_reaches_command_line_evaluate_identity_and_words_from_two_files(tmp_path):
    tree = shutil.copytree(SOURCE, tmp_path / "src" / "robustflow", ignore=shutil.ignore_patterns("__pycache__"))
    for name, (before, after) in PLANTED.items():
        text = (tree / name).read_text()
        assert text.count(before) == 1
        (tree / name).write_text(text.replace(before, after))
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "src")}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    made = json.loads(done.stdout.splitlines()[-1])
    few = {"corruptions": ["contrast"], "severities": [1], "examples": False, "progress": False}
    today = rf.evaluate("tiny", output=tmp_path / "today", **few)
    assert made["digests"][0] == today.manifest.identity_digest != made["digests"][1]
    assert (made["recorded"], made["absent"], made["restored"], made["words"]) == (3, True, 3, "haze 3")


def test_evaluate_has_the_options_of_the_configuration_with_their_defaults():
    parameters = inspect.signature(rf.evaluate).parameters
    assert parameters.keys() - {"model", "progress"} == FIELDS.keys()
    assert {name: parameters[name].default for name in FIELDS} == {name: one.default for name, one in FIELDS.items()}


def test_every_option_of_the_configuration_is_one_of_the_command_line():
    run = typer.main.get_command(app).commands["run"]
    shown = {parameter.name for parameter in run.params}
    assert {name for name, field in FIELDS.items() if option_of(field)} <= shown
    assert {name for name, field in FIELDS.items() if not option_of(field)} == {"draws"}  # --seeds


def test_the_identity_has_every_option_that_changes_rows():
    config = RunConfig()
    assert FrameIdentity.model_fields.keys() > type(config.frames).model_fields.keys()
    assert Measuring.model_fields.keys() > type(config.measuring).model_fields.keys()
