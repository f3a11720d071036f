"""Test shell completion, requested the way a shell does."""

import pytest
from typer.testing import CliRunner

from robustflow.cli.main import app


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
