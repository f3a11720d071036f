"""Complete runs: their rows, what continues them, and what is refused."""

import subprocess
import sys
from functools import partial
from importlib import import_module, invalidate_caches

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, RunError
from robustflow.corruptions.digital import Contrast
from robustflow.models import ModelRef
from robustflow.run.store import RunFolder
from robustflow.run.trust import write_array

from ..refusals import refusal
from .conftest import FAST, SMALLEST

pytestmark = pytest.mark.usefixtures("demo_is_small")

MODELS = "tests.run.models_for_tests"
HEIGHT, WIDTH = 167, 247
DIS = ModelRef.parse("dis", {"preset": "ultrafast"})


def _trouble(kind):
    return ModelRef.parse(f"{MODELS}:Trouble", (("trouble", kind),))


def _run(folder, **options):
    return rf.evaluate(DIS, "demo", output=folder, **{"corruptions": FAST, "severities": [1, 4], **options})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return _run(tmp_path_factory.mktemp("whole") / "run")


def test_a_finished_run_computes_nothing_again_but_one_row_to_compare(tmp_path, monkeypatch):
    log = tmp_path / "log"
    monkeypatch.setenv("PREDICTION_LOG", str(log))
    spec = ModelRef.parse(f"{MODELS}:Logged", (("shape", f"{HEIGHT}x{WIDTH}"),))
    first = rf.evaluate(spec, output=tmp_path / "run", corruptions=FAST, severities=[2, 3])
    asked = log.read_text().splitlines()
    assert len(asked) == len({line.split(" ", 1)[1] for line in asked}) == 1 + 2 * len(FAST)
    again = rf.evaluate(spec, output=tmp_path / "run", corruptions=FAST, severities=[2, 3])
    more = [line.split(" ", 1)[1] for line in log.read_text().splitlines()[len(asked) :]]
    assert more == ["motorcycle clean 0"], "one row is measured again to check that the model has not changed"
    assert again.rows.equals(first.rows)


def test_rows_depend_on_the_seed_only(tmp_path):
    digests = {}
    for number, seed in enumerate((0, 0, 1)):
        run = _run(tmp_path / f"run{number}", seed=seed, corruptions=["impulse_noise", "contrast"], severities=[3])
        digests.setdefault(seed, []).append(dict(run.rows.select("corruption", "frames_digest").iter_rows()))
    assert digests[0][0] == digests[0][1]
    assert digests[1][0]["impulse_noise"] != digests[0][0]["impulse_noise"]
    assert digests[1][0]["contrast"] == digests[0][0]["contrast"], "contrast is not random"


def test_another_model_seed_or_variant_is_refused_in_the_same_folder(whole):
    assert "seed" in str(refusal(lambda: _run(whole.path, seed=1), RunError, whole.path))
    assert "model" in str(refusal(lambda: rf.evaluate("farneback", output=whole.path), RunError, whole.path))


def test_a_run_that_failed_before_its_first_row_starts_from_scratch(tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(ModelError):
        rf.evaluate(_trouble("raises"), output=folder, **SMALLEST)
    clean = RunFolder(folder).clean_path("motorcycle")
    clean.parent.mkdir(exist_ok=True)
    write_array(clean, np.ones((HEIGHT, WIDTH, 2), np.float32), "motorcycle")  # left by a killed run
    result = rf.evaluate("robustflow.testing:ZeroFlow", output=folder, corruptions=["contrast"], severities=[2])
    assert result.rcre == 0.0
    assert result.manifest.identity.model.settings["spec"] == "robustflow.testing:ZeroFlow"
    assert result.manifest.severities == (2,)


def test_an_edited_model_file_does_not_continue_the_old_run(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    source = "import numpy as np\ndef flow(a, b): return np.full((*a.shape[:2], 2), {}, np.float32)\n"
    (tmp_path / "mine_for_test.py").write_text(source.format(1))
    rf.evaluate("mine_for_test:flow", output=tmp_path / "run", **SMALLEST)
    (tmp_path / "mine_for_test.py").write_text(source.format(2))
    again = partial(rf.evaluate, "mine_for_test:flow", output=tmp_path / "run", **SMALLEST)
    assert "model" in str(refusal(again, RunError, tmp_path / "run"))


def test_an_object_of_an_edited_class_does_not_get_the_rows_of_the_old_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    source = (
        "import numpy as np\n\n\nclass Mine:\n    def predict(self, a, b):\n"
        "        return np.full((*a.shape[:2], 2), {} * (a.std() < 40), np.float32)\n"  # zero on the clean pair
    )
    monkeypatch.chdir(tmp_path)
    means = []
    for value in (1, 20):  # of different length, because Python compares it with that of the compiled file
        monkeypatch.delitem(sys.modules, "mine_as_object", raising=False)
        (tmp_path / "mine_as_object.py").write_text(source.format(value))
        invalidate_caches()
        mine = import_module("mine_as_object").Mine
        means.append(rf.evaluate(mine(), corruptions=["contrast"], severities=[5]).epe)
    assert means[0] != means[1]


def test_run_does_not_continue_with_an_object_that_predicts_differently(tmp_path):
    def constant(value):
        return lambda frame1, frame2: np.full((*frame1.shape[:2], 2), value, np.float32)

    folder = tmp_path / "run"
    first = rf.evaluate(constant(1.0), output=folder, **SMALLEST)
    other = partial(rf.evaluate, constant(2.0), output=folder, corruptions=["contrast"], severities=[2])
    refusal(other, RunError, "motorcycle")
    assert rf.Result(folder).rows.equals(first.rows)
    more = rf.evaluate(constant(1.0), output=folder, corruptions=["contrast"], severities=[2])
    assert more.rows.height == 2
    assert rf.load_run(folder).rows.height == 3


@pytest.mark.parametrize(
    ("trouble", "engine", "error", "fact"),
    [
        ("nan", "serial", ModelError, " 1 "),
        ("shape", "serial", ModelError, f"(2, {HEIGHT}, {WIDTH})"),
        ("exits", "serial", ModelError, "SystemExit: 2"),
        ("exits", "processes", ModelError, "SystemExit: 2"),
        ("stops as a generator", "serial", ModelError, "GeneratorExit: closed"),
        ("stops as a generator", "processes", ModelError, "GeneratorExit: closed"),
        ("stops as on Ctrl-C", "processes", ModelError, "KeyboardInterrupt: pressed"),
        ("raises", "processes", ModelError, "ValueError: no weights"),
        ("raises silently", "processes", ModelError, "SilentError"),
        ("hangs", None, ModelError, " 0.5 "),
        ("dies", "processes", RunError, "17"),
        ("crashes", "processes", RunError, "SIGSEGV"),
    ],
)
def test_a_model_that_does_not_return_a_flow_ends_the_run(tmp_path, trouble, engine, error, fact):
    options = {"engine": engine, "workers": 1 if engine else None, "timeout": 0.5 if trouble == "hangs" else None}
    run = partial(rf.evaluate, _trouble(trouble), output=tmp_path / "run", corruptions=FAST, **options)
    message = str(refusal(run, error, "sample 'motorcycle', clean"))
    assert fact in message
    if error is RunError:
        assert "models_for_tests:Trouble" in message
        assert "--workers" not in message
    assert not list((tmp_path / "run" / "rows").iterdir())


def _needs_too_much(library):
    pixel = np.zeros((1, 1), np.uint8)
    return cv2.copyMakeBorder(pixel, 0, 2**29, 0, 2**29, 0) if library == "OpenCV" else np.zeros((2**29, 2**29))


@pytest.mark.parametrize("library", ["NumPy", "OpenCV"])
def test_too_little_memory_for_a_corruption_names_the_cell_and_keeps_the_rows(tmp_path, monkeypatch, library):
    monkeypatch.setattr(Contrast, "apply", lambda *_: _needs_too_much(library))
    run = partial(rf.evaluate, DIS, output=tmp_path / "run", corruptions="contrast", severities=1)
    refusal(run, RunError, "sample 'motorcycle', contrast severity 1")
    assert rf.load_run(tmp_path / "run").rows["corruption"].to_list() == ["clean"]


@pytest.mark.parametrize("batch_size", [1, 2])
def test_a_model_that_writes_into_its_frames_changes_no_row(tmp_path, batch_size):
    """The contrast frames are computed from the clean frames after the model has overwritten its input."""
    options = {"corruptions": ["contrast"], "severities": [1, 2], "batch_size": batch_size}
    rows = rf.evaluate(f"{MODELS}:Blackens", output=tmp_path / "run", **options).rows
    sample = rf.load_dataset("motorcycle", None).load("motorcycle")
    frames = rf.corrupt(*sample.frames, "contrast", 2, key="motorcycle")
    flow = np.stack([frames[0][..., 0], frames[1][..., 1]], axis=2).astype(np.float64)
    epe = np.linalg.norm(flow - sample.flow, axis=2)[sample.valid].sum()
    row = rows.filter((rows["corruption"] == "contrast") & (rows["severity"] == 2)).row(0, named=True)
    assert row["epe_sum"] == pytest.approx(epe, rel=1e-6)


@pytest.mark.parametrize(
    "options", [{}, {"batch_size": 2}, {"confidence": "forward-backward"}, {"still": True, "draws": 2}], ids=str
)
def test_a_model_that_reuses_its_output_array_has_the_rows_of_one_that_does_not(tmp_path, clip_folder, options):
    """Otherwise, the clean flow would become the flow of the next prediction, and every RCRE 0."""
    options = {"corruptions": ["contrast", "impulse_noise"], "severities": [2, 4], "limit": 1, **options}
    fresh, reusing = (
        rf.evaluate(f"{MODELS}:{name}", "folder", clip_folder, tmp_path / name, **options).rows
        for name in ("Sure", "ReusesItsBuffer")
    )
    assert fresh.filter(fresh["corruption"] != "clean")["rcre_all_sum"].min() > 0
    assert reusing.equals(fresh)


def test_a_damaged_flow_file_is_named_and_no_model_blamed(tmp_path):
    (tmp_path / "flows" / "clean").mkdir(parents=True)
    (tmp_path / "flows" / "clean" / "motorcycle.flo").write_bytes(b"<html>")
    run = partial(rf.evaluate, str(tmp_path / "flows"), output=tmp_path / "run", corruptions=["contrast"])
    refusal(run, ModelError, tmp_path / "flows/clean/motorcycle.flo")


def test_invalid_predictions_can_be_allowed_and_are_counted(tmp_path):
    run = rf.evaluate(_trouble("nan"), output=tmp_path / "run", allow_invalid=True, **SMALLEST)
    assert run.measured.n_invalid == 2
    assert run.rows["n_all"].to_list() == [HEIGHT * WIDTH - 1] * 2


def test_script_without_a_main_guard_is_told_to_add_one(tmp_path):
    (tmp_path / "script.py").write_text(
        "import robustflow as rf\n"
        "rf.evaluate('farneback', output='run', corruptions='contrast', engine='processes', workers=1)\n"
    )
    ended = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 1
    errors = [line for line in ended.stderr.splitlines() if line.startswith("robustflow.core.errors.")]
    assert errors
    assert all("needs its code under `if __name__" in line for line in errors)
