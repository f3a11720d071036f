"""A careless command or call is refused with what was meant: the option, the name, the list."""

from pathlib import Path

import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, RobustFlowError, UsageError

from .conftest import write_frames

MISPLACED = [
    ("run dis -c fog snow -o made", "snow", "--corruptions fog,snow"),
    ("run dis -c fog, snow -o made", "snow", "--corruptions fog"),
    ("run dis -c fog -s 1 2 -o made", "2", "--severities 1,2"),
    ("run dis --attacks square fgsm -o made", "fgsm", "--attacks square,fgsm"),
    ("run dis kitti-fc -o made", "kitti-fc", "--benchmark kitti-fc"),
    ("run dis frames -o made", "frames", "--data frames"),
    ("run dis frames/000.png -o made", "frames/000.png", "--data frames/000.png"),
    ("run weather", "weather", "--corruptions weather"),
    ("run -m dis,farneback", "dis,farneback", "dis farneback"),
    ("run dis nope -o made", "nope", "Known"),
    ("run dis -c weathr", "weathr", "'weather'"),
    ("run json", "json", "Known"),
    ("predict dis frames/000.png", "dis", "--model dis"),
    ("predict frames -c fog", "-c", "run"),
    ("corrupt frames/000.png frames/001.png fog", "fog", "--corruptions fog"),
    ("corrupt frames/000.png frames/001.png -m dis", "-m", "predict"),
    ("gallery frames", "frames", "--clip frames"),
    ("list fog", "fog", "list corruptions"),
    ("compare dis farneback", "dis", "run dis"),
    ("train raft ood", "ood", "--recipe ood"),
    ("app dis", "dis", "--model dis"),
    ("check json", "json", "MODULE:ATTRIBUTE"),
    ("check dis:Dis", "dis:Dis", "registered"),
    ("check dis -O preset=slow", "slow", "ultrafast"),
    ("dis", "dis", "run dis"),
]
"""A command, what is at fault, and what its message proposes."""


@pytest.mark.parametrize(("command", "culprit", "proposed"), MISPLACED, ids=[case[0] for case in MISPLACED])
def test_misplaced_word_is_refused_with_its_place_before_anything_runs(robustflow, command, culprit, proposed):
    write_frames(Path("frames"))
    message = robustflow.refuses(*command.split())
    robustflow.refusal(command, UsageError, culprit)
    assert proposed in message
    assert not Path("made").exists()


def test_quoted_list_with_spaces_is_refused_with_commas(robustflow):
    assert "fog,snow" in robustflow.refuses("run", "dis", "-c", "fog snow")


@pytest.mark.parametrize("target", ["dis -O preset=fast", "fog", "random_sign"])
def test_check_takes_registered_names_and_options(robustflow, target):
    assert "all checks passed" in robustflow.prints("check", *target.split())


@pytest.mark.parametrize("target", ["made:Model -O size=3", "made:Model"])
def test_check_passes_options_to_a_class(robustflow, tmp_path, target):
    (tmp_path / "made.py").write_text(
        "from robustflow.testing import ConstantFlow\n\n\nclass Model(ConstantFlow):\n"
        "    def __init__(self, size):\n        super().__init__(size)\n"
    )
    code, _, error = robustflow("check", *target.split())
    assert code == (0 if "-O" in target else 2), error


ARGUMENTS = [
    ({"benchmark": "PATH"}, "PATH", "data="),
    ({"benchmark": Path("PATH")}, "PATH", "data="),
    ({"benchmark": "dis"}, "dis", "model"),
    ({"corruptions": "fog,snow"}, "fog,snow", "['fog', 'snow']"),
    ({"corruptions": "fog snow"}, "fog snow", "['fog', 'snow']"),
    ({"corruptions": [["fog"]]}, "corruptions", "list"),
    ({"corruptions": {"fog": 3}}, "corruptions", "list"),
    ({"corruptions": 5}, "corruptions", "list"),
    ({"attacks": "square,fgsm"}, "square,fgsm", "['square', 'fgsm']"),
    ({"severities": "3"}, "3", "integer"),
    ({"severities": {1: 2}}, "severities", "list"),
    ({"limit": "3"}, "limit", "integer"),
    ({"seed": "3"}, "seed", "number"),
    ({"batch_size": 4}, "batch_size", "predict_batch"),
    ({"engine": "serial", "workers": 3}, "workers", "engine='processes'"),
    ({"subset": "quick"}, "subset", "corruptions or severities"),
    ({"benchmark": "sintel"}, "data", "folder"),
    ({"data": ["a.png", "b.png"]}, "data", "path"),
    ({"data_options": ["step=2"]}, "data_options", "dictionary"),
    ({"output": 5}, "output", "path"),
    ({"name": 5}, "name", "string"),
    ({"still": "no"}, "still", "boolean"),
    ({"examples": "no"}, "examples", "boolean"),
    ({"progress": "yes"}, "progress", "object"),
]


@pytest.mark.parametrize(("arguments", "culprit", "proposed"), ARGUMENTS, ids=[str(case[0]) for case in ARGUMENTS])
def test_argument_of_a_wrong_kind_is_refused_in_the_words_of_python(tmp_path, arguments, culprit, proposed):
    here = {name: type(value)(tmp_path) if str(value) == "PATH" else value for name, value in arguments.items()}
    with pytest.raises(UsageError) as caught:
        rf.evaluate("dis", **{"output": tmp_path / "made"} | here)
    assert caught.value.culprit == culprit.replace("PATH", str(tmp_path))
    assert proposed in str(caught.value)
    assert "--" not in str(caught.value)
    assert not list(tmp_path.rglob("manifest.json"))


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: rf.load_model("dis", device="cuda"), UsageError),
        (lambda: rf.load_model("dis,farneback"), UsageError),
        (lambda: rf.load_dataset("."), UsageError),
        (lambda: rf.evaluate("tests"), ModelError),
        (lambda: rf.evaluate(["dis"]), ModelError),
    ],
)
def test_python_error_names_no_option(call, error, tmp_path, monkeypatch):
    (tmp_path / "tests").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RobustFlowError) as caught:
        call()
    assert type(caught.value) is error
    assert "--" not in str(caught.value)
