"""User-defined corruptions (modules, classes, objects, entry points) are checked, named and identified."""

from __future__ import annotations

import importlib
import linecache
import os
import pickle
import subprocess
import sys
import threading
from types import ModuleType

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.corruptions import DepthCorruption, corruption_name, corruption_names, load_corruption
from robustflow.corruptions.condition import condition_of
from robustflow.corruptions.digital import Contrast
from robustflow.corruptions.weather.fog import Fog
from robustflow.corruptions.weather.frost import GeneratedFrost
from robustflow.testing import check_corruption

from ..refusals import refusal
from .pictures import plane, scene, seen
from .rain import RAIN, forget, write_rain

FRAME = np.indices((24, 36)).sum(0)[..., None].repeat(3, 2).astype(np.uint8)


class Veil:
    """The same random grey value for both frames, different in every draw."""

    def __init__(self, top: int = 200) -> None:
        self.top = top

    def draw(self, rng, severity, shape):
        return rng.integer(0, self.top)

    def apply(self, frame, state, index):
        return np.maximum(frame, state).astype(np.uint8)


class Locked(Veil):
    """A class whose objects cannot be sent to other processes."""

    def __init__(self):
        super().__init__()
        self.lock = threading.Lock()


class Slotted:
    """An object without a dictionary of attributes."""

    __slots__ = ("top",)
    __init__, draw, apply = Veil.__init__, Veil.draw, Veil.apply


class NearWhite(DepthCorruption):
    """White where the scene is closer than the severity in metres, with a random black dot shared by both frames."""

    paper_severities = (1.0, 2.0, 4.0, 8.0, 16.0)

    def draw_scene(self, rng, severity, depth):
        return self.parameter(severity), rng.integer(0, 20), depth.maps

    def apply(self, frame, state, index):
        nearest, dot, maps = state
        out = np.where((maps[index] < nearest)[..., None], np.uint8(255), frame)
        out[dot, dot] = 0
        return out


class NearGrey:
    """The same corruption without a base class."""

    needs_depth = True

    def draw_scene(self, rng, severity, depth):
        return depth.maps

    def apply(self, frame, state, index):
        return np.where((state[index] < 10)[..., None], np.uint8(128), frame)


def times(factor):
    return lambda level: factor * level


def local(level):
    class Local(Veil):
        def draw(self, rng, severity, shape):
            return level

    return Local


def reimported():
    forget()
    return load_corruption(corruption_name("rain_module:Rain")).source


def test_a_module_a_class_and_an_object_are_corruptions(rain_package):
    from_module = rf.corrupt(FRAME, FRAME, "rain_module:Rain", 3, seed=1)
    again = rf.corrupt(FRAME, FRAME, "rain", 3, seed=1)
    assert all((a == b).all() for a, b in zip(from_module, again, strict=True))
    assert (from_module[0] != from_module[1]).any()
    first, second = rf.corrupt(FRAME, FRAME, Veil(), 3)
    assert (first == second).all()
    assert (first != FRAME).any()
    assert (rf.corrupt(FRAME, FRAME, Veil, 3)[0] == first).all()


def test_a_class_of_corruptions_is_sent_to_a_process_and_built_there():
    sent = pickle.loads(pickle.dumps(load_corruption(f"fog:1+{corruption_name(Locked)}", "reference")))
    assert sent.name == "fog:1+locked"
    assert sent.parts[1].made.lock is not None
    assert [part.variant for part in sent.parts] == ["reference", "reference"]


def test_own_corruption_can_be_part_of_a_stack(rain_package):
    assert corruption_name("fog+rain_module:Rain:2 + rain_module:Rain") == "fog+rain:2+rain"
    whole = rf.corrupt(FRAME, FRAME, "fog+rain_module:Rain", 3)
    assert whole[0].shape == FRAME.shape
    assert (whole[0] != rf.corrupt(FRAME, FRAME, "fog", 3)[0]).any()
    assert condition_of("fog:2+rain").levels((1, 2)) == (1, 2)


@pytest.mark.parametrize("name", ["os:system", "fog:x", "rain_module:Rain"])
def test_reading_a_name_imports_nothing(rain_package, name):
    """Names in run folders and records are untrusted."""
    for read in (lambda name: condition_of(name).check(), load_corruption):
        with pytest.raises(UsageError):
            read(name)
    assert "rain_module" not in sys.modules


def test_frames_that_a_corruption_returns_in_the_same_array_keep_their_pixels():
    out = np.empty((4, 6, 3), np.uint8)

    class InOneArray(Veil):
        def apply(self, frame, state, index):
            return np.subtract(frame, 2, out=out)

    made = rf.corrupt(np.full_like(out, 40), np.full_like(out, 90), InOneArray(), severity=2)
    assert [int(frame[0, 0, 0]) for frame in made] == [38, 88]


@pytest.mark.parametrize("wrong", [1.5, (1.5,), "15"])
def test_severities_of_the_wrong_number_or_form_are_refused(wrong):
    refusal(lambda: Contrast(severities=(0.4, 0.3)), UsageError, "contrast")
    levels = ((1.5, 2.0), wrong, (2.5, 1.7), (2.5, 1.5), (3.0, 1.4))
    refusal(lambda: Fog(severities=levels), UsageError, "fog")


def test_two_corruptions_of_one_name_cannot_be_in_one_run():
    assert corruption_names([Veil(3), "veil", "fog+veil:2"]) == ("veil", "fog+veil:2")
    for others in ([Veil(250)], [Veil], ["veil", Veil(250)]):
        refusal(lambda others=others: corruption_names([Veil(3), *others]), UsageError, "veil")


@pytest.mark.parametrize(
    "made", [Contrast("reference"), Contrast(severities=(1,) * 5), GeneratedFrost(), load_corruption("fog:2+snow")]
)
def test_object_that_differs_from_its_registered_name_is_refused_in_a_run(made):
    """A run loads each corruption by its name."""
    assert corruption_names([Contrast(), Fog()]) == ("contrast", "fog")
    refusal(lambda: corruption_names([made]), UsageError, made.name)


@pytest.mark.parametrize(
    ("spec", "culprit"),
    [
        ("os:getcwd", "the function getcwd"),
        ("rain_module:Rian", "Rian"),
        ("no_such_module:Rain", "no_such_module:Rain"),
        ("fog:x", "fog:x"),
        (type("Fog", (Veil,), {}), "fog"),
        (type("Clean", (Veil,), {}), "clean"),
        (type("Four", (Veil,), {"severities": (1, 2, 3, 4)}), "four"),
        (type("Ten", (Veil,), {"severities": 10}), "ten"),
        (type("Moves", (Veil,), {"truth": "moved"}), "moves"),
        (type("Bare", (Veil,), {"needs_depth": True}), "tests.corruptions.test_own:Bare"),
    ],
)
def test_object_that_is_not_a_corruption_is_refused(rain_package, spec, culprit):
    refusal(lambda: rf.corrupt(FRAME, FRAME, spec, 1), UsageError, culprit)


@pytest.mark.parametrize(
    "body",
    [
        "frame[0] = 1; return frame",
        "return frame / 2",
        "return frame[1:]",
        "return None",
        "return np.random.default_rng().integers(0, 255, frame.shape).astype(np.uint8)",
        "self.n = getattr(self, 'n', 0) + 1; return np.full_like(frame, self.n)",
        "raise ValueError('no rain today')",
    ],
)
def test_check_corruption_finds_each_fault(body):
    space = {"np": np}
    draw, apply = "def draw(self, rng, severity, shape): return 0", f"def apply(self, frame, state, index): {body}"
    exec(f"class Bad:\n {draw}\n {apply}", space)
    with pytest.raises(UsageError):
        check_corruption(space["Bad"])


class Swirl:
    """Moves content by up to 10 px along x, in a wave down the frame."""

    def draw(self, rng, severity, shape):
        return np.rint(2 * severity * np.sin(np.arange(shape[0]) / 10)).astype(int)

    def apply(self, frame, state, index):
        return np.stack([np.roll(row, shift, axis=0) for row, shift in zip(frame, state, strict=True)])


class Shake(Swirl):
    """Shifts each frame by a different vector."""

    def draw(self, rng, severity, shape):
        return severity

    def apply(self, frame, state, index):
        return np.roll(frame, 3 * state * index, axis=1)


class Shift(Shake):
    """Shifts both frames by the same vector."""

    def apply(self, frame, state, index):
        return np.roll(frame, state, axis=1)


@pytest.mark.parametrize("made", [Swirl, Shake])
def test_check_corruption_refuses_one_that_moves_content_unless_it_leaves_no_truth(made):
    refusal(lambda: check_corruption(made), UsageError, corruption_name(made))
    check_corruption(type(made.__name__, (made,), {"truth": "none"}))


def test_check_corruption_accepts_shipped_corruptions():
    check_corruption(Shift)
    names = ["contrast", "snow", "glass_blur", "camera_motion_blur", "psf_blur", "elastic_transform"]
    assert [check_corruption(name) for name in names] == names


def test_the_source_names_files_and_attributes(rain_package):
    before = reimported()
    assert before == reimported() != ""
    (rain_package / "rain_depth.py").write_text("DEPTH = 5\n")
    imported = reimported()
    (rain_package / "rain_module.py").write_text(RAIN + "# edited\n")
    assert len({before, imported, reimported()}) == 3
    assert load_corruption(Veil(3)).source == load_corruption(Veil(3)).source != load_corruption(Veil(4)).source
    assert load_corruption("fog").source == ""
    functions = [lambda level: level, lambda level: 2 * level, times(2), times(3)]
    assert len({load_corruption(Veil(each)).source for each in functions}) == 4
    assert load_corruption(local(3)).source == load_corruption(local(3)).source != load_corruption(local(4)).source
    assert load_corruption(Slotted(3)).source != load_corruption(Slotted(4)).source
    for top in (object(), Slotted(3).draw, np.array([object()])):  # the bytes of such an array are addresses
        refusal(lambda top=top: load_corruption(Veil(top)).source, UsageError, "Veil.top")
    refusal(lambda: load_corruption(Veil(times(object()))).source, UsageError, "Veil.top")


IN_SCRIPT = """
from argparse import Namespace
from functools import partial
AMOUNT, LATER, OPTIONS = 3, 5, Namespace(top=11)
def amount(): return AMOUNT + OPTIONS.top
class Helper:
    def twice(self): return 22
class InScript:
    severities = 1, 2, 7, 8, 9
    @staticmethod
    def draw(rng, severity, shape): return amount() + Helper().twice()
    def apply(self, frame, state, index): return frame
"""


@pytest.fixture
def source(tmp_path, monkeypatch):
    """Return the source of `InScript` in a program: a script, a module, or a notebook with a cell before each class."""

    def of(program, kind="notebook"):
        file = tmp_path / "script.py"
        file.write_text(program)
        main = ModuleType("wave" if kind == "module" else "__main__")  # `wave` is also one of the standard library
        monkeypatch.setitem(sys.modules, main.__name__, main)
        if kind == "notebook":
            cells = {f"<cell {n}>": "class " * (n > 0) + cell for n, cell in enumerate(program.split("class "))}
        else:
            main.__file__, cells = str(file), {str(file): program}
        for name, cell in cells.items():
            monkeypatch.setitem(linecache.cache, name, (len(cell), None, cell.splitlines(True), name))
            exec(compile(cell, name, "exec"), vars(main))
        return load_corruption(main.InScript).source

    return of


EDITS = {
    "3": "4",
    "return AMOUNT": "return 2 * AMOUNT",
    "7": "6",
    "return frame": "return frame + 1",
    "11": "8",
    "22": "33",
}


@pytest.mark.parametrize("kind", ["script", "notebook", "module"])
def test_the_source_of_a_class_includes_the_text_and_the_variables_that_it_uses(source, kind):
    assert source(IN_SCRIPT, kind) == source(IN_SCRIPT, kind)
    edited = [source(IN_SCRIPT.replace(*edit), kind) for edit in EDITS.items()]
    assert len({source(IN_SCRIPT, kind), *edited}) == 1 + len(EDITS)
    assert (source(IN_SCRIPT, kind) == source(IN_SCRIPT + "class Unused: ...\n", kind)) == (kind == "notebook")


def test_a_variable_that_cannot_be_recognised_is_refused_in_a_notebook_and_counts_as_text_in_a_script(source):
    holding = IN_SCRIPT.replace("def amount():", "HELD = partial(round, 44)\ndef amount(held=HELD):")
    assert source(holding, "script") == source(holding, "script") != source(holding.replace("44", "55"), "script")
    refusal(lambda: source(holding), UsageError, "InScript")
    described = holding.replace("severities", "source = '44'\n    severities")
    assert source(described) == source(described) != source(described.replace("'44'", "'55'"))


def test_a_value_from_the_command_line_counts_in_a_script(source, monkeypatch):
    program = IN_SCRIPT.replace("AMOUNT, LATER", "import sys\nAMOUNT, LATER").replace("= 3,", "= len(sys.argv),")
    before = source(program, "script")
    monkeypatch.setattr(sys, "argv", sys.argv * 9)
    assert before != source(program, "script")


def test_a_class_of_a_session_without_its_text_is_refused_unless_it_says_what_it_is(monkeypatch):
    main = ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", main)
    exec(IN_SCRIPT, vars(main))
    refusal(lambda: load_corruption(main.InScript).source, UsageError, "InScript")
    main.InScript.source = "grey"
    assert load_corruption(main.InScript).source


@pytest.mark.parametrize("imported", ["import rain_depth as at", "from rain_depth import DEPTH, wet, Wet"])
def test_the_source_of_a_class_of_a_notebook_includes_the_modules_that_it_uses(rain_package, source, imported):
    def with_depth(depth):
        forget()
        (rain_package / "rain_depth.py").write_text(f"DEPTH = 1\ndef wet(): return {depth}\nclass Wet: ...\n")
        return source(imported + IN_SCRIPT.replace("amount() +", "at.wet() +" if " as " in imported else "wet() +"))

    assert with_depth(1) == with_depth(1) != with_depth(2)


def test_a_property_source_adds_to_the_attributes_and_stands_for_those_that_cannot_be_recognised(monkeypatch):
    monkeypatch.setattr(Veil, "source", "texture 1", raising=False)
    made = [load_corruption(Veil(top)).source for top in (3, 4, object())]
    assert load_corruption(Veil(object())).source == made[2]
    monkeypatch.setattr(Veil, "source", b"texture 2")
    made += [load_corruption(Veil(3)).source, load_corruption(Veil(object())).source]
    assert len(set(made)) == 5
    monkeypatch.setattr(Veil, "source", property(lambda self: 1 / 0))
    refusal(lambda: load_corruption(Veil(3)).source, UsageError, "Veil")


def test_the_source_names_modules_that_a_method_imports_and_no_installed_ones(rain_package, monkeypatch):
    installed = rain_package / ".venv/lib/site-packages"
    installed.mkdir(parents=True)
    monkeypatch.syspath_prepend(installed)
    (installed / "rain_installed.py").write_text("WET = 1\n")
    late = rain_package / "rain_late.py"
    late.write_text("import rain_installed\n")
    (rain_package / "rain_module.py").write_text(RAIN + "    def wet(self):\n        import rain_late\n")
    before = reimported()
    importlib.import_module("rain_late")
    (installed / "rain_installed.py").write_text("WET = 2\n")
    assert reimported() == before
    late.write_text("import rain_installed  # edited\n")
    assert reimported() != before


@pytest.mark.parametrize("made", [NearWhite, NearWhite(), NearGrey, NearGrey(), "tests.corruptions.test_own:NearWhite"])
def test_an_own_corruption_in_three_dimensions_gets_the_depth_of_each_frame(made):
    metres = np.arange(1, 1 + FRAME.shape[1], dtype=np.float32) * np.ones((len(FRAME), 1), np.float32)
    name = corruption_name(made)
    limit, value = (8, 255) if name == "near_white" else (10, 128)
    for frame, depth in zip(
        rf.corrupt(FRAME, FRAME, made, 4, depth=seen(metres, 50 - metres)), (metres, 50 - metres), strict=True
    ):
        expected = np.where((depth < limit)[..., None], np.uint8(value), FRAME)
        assert (frame != expected).any(axis=2).sum() <= (name == "near_white")  # its random dot
    assert condition_of(name).needs_depth
    assert condition_of(f"fog+{name}:2").needs_depth
    assert not any(condition_of(flat).needs_depth for flat in (corruption_name(Veil), "of_another_machine:2+fog"))


def test_an_own_corruption_in_three_dimensions_stacks_with_others():
    depth = plane(2.0, FRAME.shape[:2])
    whole, alone = (
        rf.corrupt(FRAME, FRAME, name, 5, depth=depth)[0]
        for name in (f"{corruption_name(NearGrey)}+contrast", "contrast")
    )
    assert len(np.unique(whole)) == 1
    assert len(np.unique(alone)) > 1


@pytest.mark.parametrize("part", [lambda depth: depth.maps[0], lambda depth: depth.camera.translation])
def test_an_own_corruption_cannot_change_the_depth_that_the_next_one_gets(part):
    class Changes(NearGrey):
        def draw_scene(self, rng, severity, depth):
            part(depth)[:] = 0

    depth = scene(*FRAME.shape[:2])
    with pytest.raises(UsageError):
        rf.corrupt(FRAME, FRAME, Changes, 3, depth=depth)
    assert part(depth).any()


def test_check_corruption_tries_depth_with_a_camera_of_known_and_of_unknown_motion():
    class Parallax(NearWhite):
        def draw_scene(self, rng, severity, depth):
            given.append((depth.maps[0].shape, depth.camera.translation is None))
            return super().draw_scene(rng, severity, depth)

    given = []
    assert check_corruption(Parallax) == "parallax"
    assert check_corruption(NearGrey) == "near_grey"
    assert {shape for shape, _ in given} == {(48, 64), (33, 61), (128, 128)}
    assert {unknown for _, unknown in given} == {False, True}


SCRIPT = """
import numpy as np
from robustflow.corruptions import CORRUPTIONS, corrupt, load_corruption
from robustflow.corruptions.api import user_sources
from robustflow.corruptions.condition import condition_of
from robustflow.core.errors import DataError, UsageError
frame = np.full((24, 36, 3), 9, np.uint8)
assert "rain" in CORRUPTIONS.names()
assert (corrupt(frame, frame, "fog+rain", 3)[0] != corrupt(frame, frame, "fog", 3)[0]).any()
print(user_sources([load_corruption("fog+rain:2")])["corruptions"]["rain"])
assert condition_of("fog+haze").needs_depth and not condition_of("fog+rain").needs_depth
for name in ("sleet", "gone", "hail"):
    try:
        load_corruption(name)
    except UsageError as error:
        print(error.culprit)
"""


HAZE = """
import numpy as np
from robustflow.corruptions import DepthCorruption
class Haze(DepthCorruption):
    paper_severities = (1, 2, 3, 4, 5)
    def draw_scene(self, rng, severity, depth):
        return depth.maps
    def apply(self, frame, state, index):
        return frame.copy()
"""


def test_corruption_of_an_entry_point_is_registered(tmp_path):
    site = tmp_path / "site"
    info = site / "weather-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: weather\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[robustflow.corruptions]\nrain = rain_module:Rain\nsleet = rain_module:Rain\nhaze = haze_module:Haze\n"
        "gone = no_module:Gone\nhail = haze_module:np\n"
    )
    (site / "haze_module.py").write_text(HAZE)
    write_rain(site)

    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env={**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    source, *culprits = done.stdout.splitlines()
    assert len(source) == 16
    assert culprits == ["sleet", "gone", "builtins:module"]
