"""The working folder is untrusted: a command started there does not execute any file in it, and no file in it changes a
number or a figure.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from hashlib import sha256
from importlib.metadata import packages_distributions
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest

from robustflow.core import compiled
from robustflow.core.environment import SAFE_PATH
from robustflow.core.errors import UsageError
from robustflow.report.figures import clean_against_cre, figure_bytes
from robustflow.stats.published.tables import published_lines
from tests.refusals import refusal

from ..app.launch import running_app
from ..training.chairs import write_chairs
from .conftest import write_frames

SCRIPT = "import sys\nfrom robustflow.cli.main import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
"""The `robustflow` script as written by an installer."""

SCRIPT_OF_SEVERAL = SCRIPT.replace(
    "sys.exit(main())",
    """
    rest, stops = sys.argv[1:], []
    while rest:
        end = rest.index("then") if "then" in rest else len(rest)
        sys.argv[1:], rest = rest[:end], rest[end + 1 :]
        try:
            main()
        except SystemExit as stop:
            stops.append(stop.code)
    sys.exit(next(filter(None, stops), 0))""",
)
"""Like `SCRIPT`, but for several commands separated by "then", which import the package only once."""


def _python(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    # commands run here set this variable
    environment = {name: value for name, value in os.environ.items() if name != SAFE_PATH}
    begin = [sys.executable, *map(str, arguments)]
    return subprocess.run(begin, cwd=folder, env=environment, capture_output=True, text=True, check=False)


class Place:
    """A folder with a decoy of every module that could be imported; each records its name when it is run.

    Args:
        root: parent folder of the working folder `here` and of all other folders.
    """

    def __init__(self, root: Path) -> None:
        self.here, self.marker, self.script = root / "here", root / "run", root / "bin" / "robustflow"
        self.here.mkdir()
        self.script.parent.mkdir()
        self.script.write_text(SCRIPT)
        self.several = self.script.with_name("several")
        self.several.write_text(SCRIPT_OF_SEVERAL)
        names = {*sys.stdlib_module_names, *packages_distributions(), "sitecustomize", "usercustomize"}
        assert {"multiprocessing", "numpy", "numba", "pip"} <= names
        for name in names - {"robustflow"}:
            if name.isidentifier():
                text = f"open({str(self.marker)!r}, 'a').write({name!r} + '\\n')\nraise SystemExit('decoy')\n"
                (self.here / f"{name}.py").write_text(text)

    def command(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return self.python(self.script, *arguments)

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return _python(self.here, *arguments)

    def what_ran(self) -> list[str]:
        """Return the names of the decoys executed since the last call."""
        names = sorted(set(self.marker.read_text().split())) if self.marker.exists() else []
        self.marker.unlink(missing_ok=True)
        return names


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(tmp_path_factory.mktemp("place"))


def _finishes(place: Place, *arguments: object) -> str:
    done = place.python(place.several, *arguments)
    assert place.what_ran() == []
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def _prepare(tmp_path: Path, frames: Path) -> tuple[object, ...]:
    return ("prepare", "gopro-fc", "-d", frames, "-o", tmp_path / "prepared", "--fps", 30, "--factor", 1)


def test_decoys_that_python_imports_at_start_run(place):
    place.python("-c", "import multiprocessing")
    assert place.what_ran() in (["multiprocessing"], ["linecache"])  # which one runs depends on the version of Python


def test_python_m_in_a_folder_of_decoys_runs_only_those_that_python_loads_first(tmp_path):
    place = Place(tmp_path)
    (tmp_path / "loaded.py").write_text("import sys\nprint(*sys.modules)\n")
    for name in _python(tmp_path, "-m", "loaded").stdout.split():
        (place.here / f"{name}.py").unlink(missing_ok=True)
    assert len(list(place.here.iterdir())) > 200
    done = place.python("-m", "robustflow", "list", "models")
    assert place.what_ran() == []
    assert "farneback" in done.stdout


def test_commands_in_a_folder_of_decoys_import_a_model_and_a_corruption_there_and_no_decoy(place, tmp_path):
    (place.here / "mine.py").write_text(
        "import helper\nimport numpy as np\n"
        "class Still:\n"
        "    def predict(self, frame1, frame2):\n"
        "        return np.zeros((*frame1.shape[:2], 2), np.float32)\n"
        "class Darker:\n"
        "    def draw(self, rng, severity, shape):\n"
        "        return severity\n"
        "    def apply(self, frame, state, index):\n"
        "        return frame // state\n"
    )
    (place.here / "helper.py").write_text("")
    run = ("run", "-m", "mine:Still", "-c", "fog,mine:Darker", "-s", 3, "-o", tmp_path / "run", "--no-examples")
    report = ("report", tmp_path / "run")
    frames = _two_clips(tmp_path / "clips")
    corrupt = ("corrupt", frames / "a/000.png", frames / "a/001.png", "-c", "fog", "-s", 2, "-o", tmp_path / "out")
    prepare = (*_prepare(tmp_path, frames), "--workers", 2)
    engine = ("--engine", "processes", "--workers", 1)
    shown = _finishes(place, *run, *engine, "then", *report, "then", *corrupt, "then", *prepare)
    assert "darker" in shown
    assert (tmp_path / "out").exists()
    assert (tmp_path / "prepared" / "gopro_fc.json").exists()


@pytest.mark.ray
@pytest.mark.slow
def test_run_and_prepare_on_ray_in_a_folder_of_decoys_run_none(place, tmp_path):
    pytest.importorskip("ray")
    run = ("run", "-m", "dis", "-c", "fog", "-s", 3, "-o", tmp_path / "run", "--engine", "ray", "--workers", 2)
    assert "clean EPE" in _finishes(place, *run)
    _finishes(place, *_prepare(tmp_path, _two_clips(tmp_path / "clips")), "--engine", "ray")


def test_fetching_the_photographs_of_frost_runs_no_decoy(place, tmp_path, monkeypatch):
    monkeypatch.setenv("PIP_NO_INDEX", "1")  # pip starts but finds nothing
    fetch = f"from robustflow.corruptions.weather import frost_photographs as f; f._download({str(tmp_path)!r})"
    done = place.python("-P", "-c", fetch)
    assert done.returncode == 1
    assert "AssetError: " in done.stderr
    assert place.what_ran() == []


def test_the_app_in_a_folder_of_decoys_runs_none(place):
    pytest.importorskip("uvicorn")
    with running_app(place.here, start=(str(place.script),)) as app:
        assert app.preview()[0] == 200
    assert place.what_ran() == []


@pytest.mark.torch
def test_training_and_profiling_in_a_folder_of_decoys_run_none(place, tmp_path):
    pytest.importorskip("torchvision")
    write_chairs(tmp_path / "chairs", 2, (136, 152))
    train = ("train", "raft_small", "--recipe", "chairs", "--data", tmp_path / "chairs", "--output", tmp_path / "out")
    train += ("--steps", 1, "--batch-size", 1, "--crop", "128x144", "--iterations", 1, "--loaders", 1)
    profile = ("profile", "raft_small", "-O", f"checkpoint={tmp_path / 'out' / 'last.pth'}", "--size", "128x144")
    shown = _finishes(place, *train, "--plan", "then", *train, "then", *profile)
    assert (tmp_path / "out" / "last.pth").exists()
    assert "one pair" in shown


def test_a_module_of_the_working_folder_that_an_installed_one_hides_is_named(robustflow):
    Path("glob.py").write_text("class Net: ...\n")
    assert str(Path("glob.py").absolute()) in robustflow.refuses("run", "-m", "glob:Net")


def test_settings_of_numba_and_matplotlib_in_the_working_folder_change_no_number_and_no_figure(tmp_path):
    pytest.importorskip("yaml")
    stranger = tmp_path / "stranger"
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {stranger}\ndisable_jit: 1\n")
    (tmp_path / "matplotlibrc").write_text("axes.facecolor: red\nfont.size: 31\nlines.linewidth: 9\n")
    script = (
        "import sys\nfrom hashlib import sha256\nfrom robustflow.cli.main import main\n"
        "sys.argv = ['robustflow', '--version']\ntry:\n    main()\nexcept SystemExit:\n    pass\n"
        "from robustflow.core.compiled import njit\nimport numba\n"
        "from robustflow.core.rng import Rng\nRng.of('a').uniforms(3)\n"
        "print(repr(numba.config.CACHE_DIR), numba.config.DISABLE_JIT)\n"
        "from robustflow.stats.published.tables import published_lines\n"
        "from robustflow.report.figures import clean_against_cre, figure_bytes\n"
        "lines = published_lines().items()\n"
        "figure = clean_against_cre({key: line for key, line in lines if key.benchmark == 'kitti-fc'})\n"
        "print(sha256(figure_bytes(figure, 'svg')).hexdigest())\n"
    )
    done = _python(tmp_path, "-c", script)
    here = clean_against_cre({key: line for key, line in published_lines().items() if key.benchmark == "kitti-fc"})
    version, settings, digest = done.stdout.splitlines()
    assert version.startswith("robustflow ")
    assert settings == "'' 0"
    assert (digest, done.stderr) == (sha256(figure_bytes(here, "svg")).hexdigest(), "")
    assert not stranger.exists()


def test_compiled_code_is_not_read_where_everybody_could_replace_it(tmp_path, monkeypatch):
    (tmp_path / "numba").mkdir()
    (tmp_path / "numba").chmod(0o777)
    frames = write_frames(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    done = _python(tmp_path, "-m", "robustflow", "corrupt", *frames, "-c", "gaussian_noise")
    assert done.returncode == 2
    assert re.fullmatch(r"robustflow: \S+/numba: .*\n", done.stderr)


@pytest.mark.parametrize("mode", [0o755, 0o1777])
def test_compiled_code_is_read_where_only_this_user_can_replace_it(tmp_path, mode):
    (tmp_path / "numba").mkdir()
    (tmp_path / "numba").chmod(mode)
    (tmp_path / "numba" / "mine").mkdir(0o755)
    compiled._check_folder.__wrapped__(tmp_path / "numba" / "mine")


def test_a_group_of_several_users_may_not_write_compiled_code(monkeypatch):
    check = compiled._check_folder.__wrapped__
    monkeypatch.setattr(compiled, "_is_private", lambda group: group == os.getegid())
    with TemporaryDirectory() as place:  # unlike `tmp_path`, in a folder that every user can enter
        check(Path(place))
        shared = Path(place) / "shared"
        shared.mkdir()
        shared.chmod(0o770)
        check(shared)
        monkeypatch.setattr(compiled, "_is_private", lambda group: False)
        check(shared)  # other users cannot enter the folder above
        Path(place).chmod(0o711)
        refusal(lambda: check(shared), UsageError, shared)


def _two_clips(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 256, (64, 96, 3), dtype=np.uint8), (5, 5), 0)
    for name in ("a", "b"):
        (folder / name).mkdir(parents=True)
        for index in range(34):
            cv2.imwrite(str(folder / name / f"{index:03}.png"), np.roll(picture, index, axis=1))
    return folder
