"""The command line as a whole: what is built at startup, help with its examples, completion as a shell asks for it,
and the end on Ctrl-C.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
import typer
import typer.main
from rich.text import Text
from typer.testing import CliRunner

from robustflow.cli.main import app, command_line


def _commands(command, path: str) -> Iterator[tuple[str, object]]:
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from _commands(child, f"{path} {name}")


COMMANDS = dict(_commands(typer.main.get_command(app), "robustflow"))
NAMES = sorted(typer.main.get_command(app).commands)


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], [], ["rnu"], *([name, "--help"] for name in NAMES)])
def test_single_command_prints_the_same_as_with_all_commands_loaded(arguments):
    whole, started = (CliRunner().invoke(built, arguments) for built in (app, command_line(arguments)))
    assert whole.output == started.output != ""
    assert whole.exit_code == started.exit_code


def test_a_command_that_is_not_named_has_no_options():
    assert typer.main.get_command(command_line(["--help"])).commands["run"].params == []


def test_run_help_shows_eight_common_options_first_and_the_others_as_advanced():
    output = CliRunner().invoke(app, ["run", "--help"]).output
    panels = [line.split("─")[1].strip() for line in output.splitlines() if line.startswith("╭")]
    assert panels[:2] == ["Arguments", "Options"] != panels
    assert all(panel.startswith("Advanced: ") for panel in panels[2:])
    common = output[output.index("╭─ Options") : output.index("╭─ Advanced")]
    options = [line.split()[1] for line in common.splitlines() if line.startswith("│ --")]
    expected = (
        "--model --benchmark --data --corruptions,--corruption --severities,--severity --checkpoint --device --output"
    )
    assert options == [*expected.split(), "--help"]


@pytest.mark.parametrize("name", ["predict", "export"])
def test_help_of_other_commands_has_one_list_of_options(name):
    output = CliRunner().invoke(app, [name, "--help"]).output
    assert [line.split("─")[1].strip() for line in output.splitlines() if line.startswith("╭")] == [
        "Arguments",
        "Options",
    ]


def test_help_is_wrapped_to_the_terminals_width(monkeypatch):
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 300)
    lines = CliRunner().invoke(app, ["profile", "--help"]).output.splitlines()
    assert any("it omits matrix products." in line and "random unless" in line for line in lines)
    assert any(line.split() == ["robustflow", "profile", "raft"] for line in lines)  # examples keep their lines


def test_ctrl_c_while_the_command_line_is_imported_prints_no_traceback():
    script = """
import os, signal, sys
import robustflow.__main__ as start

signal.signal(signal.SIGINT, signal.default_int_handler)  # a test in the background inherits SIG_IGN

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "robustflow.cli.main":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
start.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


@pytest.mark.parametrize(
    ("shell", "code", "lines"),
    [
        ("{} list corruptions >&-", 0, 1),
        ("{} run -m dis -c contrast -s 1 --no-examples -o run >&- && {} report run >&- 2>&-", 0, 1),
        ("{} run -m dis -c contrast -s 6 -o run >&-", 2, 2),
        ("{} list corruptions >&- 2>&- <&-", 0, 0),
        ("{} list corruptions >/dev/full", 1, 1),
        ("ulimit -v 150000; {} list models", 1, 1),
        ("ulimit -v 900000; {} run -m dis -c contrast -s 1 -o run", 1, 1),
        ("ulimit -v 2400000; {} run -m dis -c contrast -s 1 -o run", 1, 1),
        ("ulimit -v 900000; {} --help > help", 0, 0),
    ],
)
def test_closed_streams_and_little_memory_are_one_line_each(tmp_path, shell, code, lines):
    command = shell.replace("{}", f"{sys.executable} -m robustflow")
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    assert sum(line.startswith("robustflow: ") for line in done.stderr.splitlines()) == lines, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("error", [MemoryError(), ImportError("cannot map a library"), RuntimeError("no new thread")])
@pytest.mark.parametrize("limit", [math.inf, 8e9])
def test_what_a_limit_of_memory_may_cause_is_one_line_and_anything_else_a_traceback(
    robustflow, monkeypatch, error, limit
):
    def fail(arguments):
        raise error

    monkeypatch.setattr("robustflow.cli.main.command_line", fail)
    monkeypatch.setattr("robustflow.cli.main._memory_limit", lambda: limit)
    if limit == math.inf and not isinstance(error, MemoryError):
        with pytest.raises(type(error)):
            robustflow("list")
    else:
        assert type(error).__name__ in robustflow.refuses("list", code=1)
    with pytest.raises(type(error)):
        robustflow("--debug", "list")


def test_a_command_that_imported_torch_ends_with_its_objects_collected():
    """At exit, triton prints thirty lines about objects that were frozen."""
    script = (
        "import atexit, gc, sys, types\n"
        "sys.modules['torch'] = types.ModuleType('torch')\n"
        "sys.argv = ['robustflow', '--version']\n"
        "atexit.register(lambda: print(gc.get_freeze_count(), file=sys.stderr))\n"
        "from robustflow.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines() == ["0"]


def test_version_and_help_do_not_import_the_heavy_parts():
    script = (
        "import sys; sys.argv = ['robustflow', '--help']\n"
        "from robustflow.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'cv2', 'polars', 'numba', 'scipy', 'torch', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "robustflow run --model dis" in done.stdout


def test_help_texts_contain_no_markup():
    texts = {path: command.help.replace("\b", "") for path, command in COMMANDS.items() if command.help}
    for path, command in COMMANDS.items():
        texts |= {f"{path} {one.name}": one.help for one in command.params if getattr(one, "help", None)}
    assert len(texts) > 250
    assert [where for where, text in texts.items() if Text.from_markup(text).plain != text] == []


def test_help_of_every_command_shows_an_example_of_it():
    for path, command in COMMANDS.items():
        if not hasattr(command, "commands"):
            written = path.replace("reproduce table", "reproduce")  # "table" may be omitted
            words = CliRunner().invoke(app, [*path.split()[1:], "--help"]).output.replace("│", "").split()
            shown = " ".join(words)
            assert written in shown.partition("Example")[2], path


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("robustflow record verif", {"verify"}),
        ("robustflow reproduce aud", {"audit"}),
        ("robustflow reproduce tab2 --mod", {"--models"}),
        ("robustflow run --model farne", {"farneback"}),
        ("robustflow run --corruptions fog,fro", {"fog,frost"}),
        ("robustflow corrupt a.png b.png -c fog+sno", {"fog+snow"}),
        ("robustflow run --benchmark kitti", {"kitti-fc"}),
        ("robustflow run -c fog -c snow --benchmark kitti", {"kitti-fc"}),
        ("robustflow run --output=~no-such-user/x --benchmark kitti", {"kitti-fc"}),
    ],
)
def test_tab_in_bash_completes_commands_and_names(typed, offered):
    words = typed.split()
    asked = {"_ROBUSTFLOW_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(words) - 1)}
    answer = CliRunner().invoke(app, env=asked, prog_name="robustflow")
    assert answer.stderr == ""
    assert offered <= set(answer.stdout.split())
    assert all(word.startswith(words[-1]) for word in answer.stdout.split())
