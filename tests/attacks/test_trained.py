"""Perturbations and patches that are trained, or read from files, which are untrusted."""

import io
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow as rf
from robustflow.attacks import load_attack, patch
from robustflow.attacks.ball import images_of
from robustflow.attacks.problem import Pair
from robustflow.attacks.trained import Universal
from robustflow.core.errors import DataError, ModelError, RunError, UsageError
from robustflow.core.rng import Rng
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelRef
from robustflow.report.attack_tables import attack_table
from robustflow.run.attack_stage import trained_attacks
from robustflow.run.plan import Unit
from robustflow.run.setup import set_up
from robustflow.run.store import RunFolder
from robustflow.run.trust import write_array
from robustflow.testing import TexturePairs

pytest.importorskip("torch", reason="needs the torch extra")

from ..refusals import refusal
from .small_runs import TINY, numbers_of, still
from .smooth_net import linear_model, random_pair, smooth_model

TRUTH = np.zeros((8, 10, 2), np.float32)
GREY = np.full((2, 8, 10, 3), 128, np.uint8)


def _learned(name, model, severity=4, pairs=None, truth=TRUTH, **options):
    attack = load_attack(name, train="2", **options)
    pairs = pairs or [random_pair(seed=seed) for seed in (1, 2)]
    given = [
        (Pair(tuple(frames), attack.budget(severity), truth, None, str(number), 0, severity), model.predict(*frames))
        for number, frames in enumerate(pairs)
    ]
    return attack, attack.learn(model, given, Rng.of(0)), given


def test_a_universal_perturbation_on_a_linear_model_reaches_the_optimum():
    model = linear_model()
    _, pattern, _ = _learned("universal", model, 4, [GREY, GREY])
    assert np.abs(pattern - 8 / 255 * np.sign(model.weights)).max() < 1e-6


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(["linf", "rms"]), st.sampled_from(["both", "first", "joint"]), st.integers(1, 4))
def test_a_universal_perturbation_is_the_same_for_every_sample(tmp_path_factory, norm, moved, severity):
    path = tmp_path_factory.mktemp("files") / "d.npy"
    np.save(path, np.random.default_rng(severity).normal(0, 0.02, (2, 3, 8, 10)).astype(np.float32))
    attack = load_attack(f"universal:file={path}", norm=norm, moved=moved)
    frames = [np.random.default_rng(seed).integers(90, 160, (2, 8, 10, 3), np.uint8) for seed in (1, 2)]
    changes = [np.stack(rf.attack(*pair, still, attack, severity).frames).astype(int) - pair for pair in frames]
    assert np.array_equal(*changes)
    assert changes[0].any()


@pytest.mark.parametrize(
    ("name", "error", "culprit"),
    [
        ("universal", UsageError, "universal"),
        ("universal:train=2", ModelError, "FunctionModel"),
        ("patch:train=2:file=a.npy", UsageError, "file"),
        ("patch:train=0", UsageError, "train"),
        ("universal:train=2:second=b.npy", UsageError, "second"),
        ("patch:moved=joint", UsageError, "joint"),
        ("worst_of:patch+universal:train=3", UsageError, "norm"),
        ("worst_of:patch:train=3", ModelError, "FunctionModel"),
        ("transfer:dis:attack=universal:train=3", ModelError, "dis"),
        ("transfer:tiny:attack=universal:train=3", UsageError, "train"),
        ("universal:file=~no_such_user_here/d.npy", DataError, "~no_such_user_here/d.npy"),
    ],
)
def test_impossible_trained_attack_is_refused(name, error, culprit):
    refusal(lambda: rf.attack(*GREY, still, name, 3), error, culprit)


def test_the_files_of_pcfa_are_read_one_for_each_frame(tmp_path):
    first, second = np.random.default_rng(0).normal(0, 0.01, (2, 1, 3, 8, 10)).astype(np.float32)
    np.save(tmp_path / "1.npy", first)
    np.save(tmp_path / "2.npy", second)
    both = rf.attack(*GREY, still, f"universal:file={tmp_path}/1.npy:second={tmp_path}/2.npy", budget=127)
    one = rf.attack(*GREY, still, f"universal:file={tmp_path}/1.npy", budget=127)
    assert np.allclose(both.images, images_of(*GREY) + np.concatenate([first, second]), atol=1e-6)
    assert np.allclose(one.images, images_of(*GREY) + first, atol=1e-6)


def _npy(array):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


HOSTILE = {
    "missing": None,
    "empty": b"",
    "zip": b"PK\x03\x04" + bytes(60),
    "pickle": pickle.dumps(partial(print, "run")),
    "objects": _npy(np.array([print, 1], object)),
    "longer than the file": _npy(np.zeros((3, 8, 10), np.float32)).replace(b"(3, 8, 10)", b"(3, 8, 99)"),
    "damaged header": b"\x93NUMPY\x01\x00\x10\x00{'descr': [[[[[[[",
    "integers": _npy(np.zeros((3, 8, 10), int)),
    "two axes": _npy(np.zeros((8, 10))),
    "two channels": _npy(np.zeros((2, 2, 8, 10))),
    "nan": _npy(np.full((3, 8, 10), np.nan)),
    "a different size": _npy(np.zeros((3, 9, 10))),
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_a_perturbation_file_that_does_not_fit_is_refused(tmp_path, content):
    path = tmp_path / "d.npy"
    if content is not None:
        path.write_bytes(content)
    refusal(lambda: rf.attack(*GREY, still, f"universal:file={path}", 3), DataError, path)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(["patch", "random_patch"]),
    st.sampled_from(["both", "first", "second"]),
    st.integers(1, 5),
    st.integers(30, 60),
    st.integers(30, 60),
    st.integers(0, 10**6),
)
def test_patch_is_a_disc_of_the_requested_area(name, moved, severity, height, width, seed):
    frames = np.random.default_rng(seed).integers(1, 255, (2, height, width, 3), np.uint8)
    budget = (0.2, 0.5, 1, 2, 5)[severity - 1]
    attacked = rf.attack(*frames, still, f"{name}:moved={moved}", budget=budget, seed=seed)
    changed = (np.stack(attacked.frames) != frames).any(axis=-1)
    expected = {"first": changed[:1], "second": changed[1:]}.get(moved, changed)
    assert not changed[{"first": 1, "second": 0}.get(moved, slice(0, 0))].any()
    for one in expected:
        assert 0 < 100 * one.mean() <= budget
        rows, columns = np.nonzero(one)
        side = max(np.ptp(rows), np.ptp(columns)) + 1
        assert side <= 2 * np.sqrt(budget / 100 * height * width / np.pi) + 2
    assert np.array_equal(expected[0], expected[-1])


def test_a_trained_patch_beats_stripes_and_random_colours_on_pairs_and_places_it_did_not_see():
    model, truth = smooth_model(), np.zeros((40, 48, 2), np.float32)
    options = {"steps": 30, "pairs": [random_pair(40, 48, seed) for seed in range(4)], "truth": truth}
    attack, pattern, _ = _learned("patch", model, 5, **options)
    trained = replace(attack, learned={5: pattern})
    patches = {"random": "random_patch", "stripes": "patch", "trained": trained}
    errors = {name: [] for name in patches}
    for seed in range(10, 16):
        for name, kind in patches.items():
            one = rf.attack(*random_pair(40, 48, seed), model, kind, 5, flow=truth, key=str(seed), seed=seed)
            errors[name].append(one.loss)
    gain = np.array(errors["trained"]) - np.maximum(errors["random"], errors["stripes"])
    assert gain.mean() > 3 * gain.std() / np.sqrt(len(gain))


def test_patch_is_moved_and_rotated_in_every_training_step(monkeypatch):
    places, given = [], smooth_model()
    paste = patch.paste
    monkeypatch.setattr(
        patch, "paste", lambda problem, pattern, place: places.append(place) or paste(problem, pattern, place)
    )
    options = {"steps": 8, "pairs": [random_pair(40, 48)], "truth": np.zeros((40, 48, 2), np.float32)}
    _learned("patch", given, 5, **options)
    assert len({(place.where[0].start, place.where[1].start) for place in places}) > 4
    assert len({place.angle for place in places}) == len(places) == 8
    assert all(abs(place.angle) <= 10 and 0.95 <= place.scale <= 1.05 for place in places)


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 25), st.integers(3, 25), st.floats(-180, 180), st.floats(0.5, 2))
def test_rotated_pattern_is_sampled_at_rotated_positions(size, side, angle, scale):
    place = patch.Disc(slice(0, 2), (slice(0, size),) * 2, np.ones((size, size), bool), Rng.of(0), angle, scale)
    ramp = np.arange(side, dtype=np.float32) - (side - 1) / 2
    rows, columns = place.taken_from(np.zeros((3, side, side), np.float32))
    shown = ramp[columns] + 1j * ramp[rows]
    there = np.arange(size) - (size - 1) / 2
    exact = (there[None] + 1j * there[:, None]) * np.exp(-1j * np.deg2rad(angle)) * side / size / scale
    inside = np.maximum(np.abs(exact.real), np.abs(exact.imag)) <= (side - 1) / 2
    assert np.abs(shown - exact)[inside].max(initial=0) <= np.sqrt(0.5) + 1e-6


DATA = TexturePairs(4, (40, 48))
UNIVERSAL, PATCH = "universal:train=2:steps=2", "patch:train=2:steps=1"
INSIDE = "transfer:tiny:attack=universal:train=2:steps=2:device=cpu"
WORST = "worst_of:random_sign+universal:train=2:steps=2"
TRAINED = [UNIVERSAL, PATCH, INSIDE, WORST]


def _run(folder, attacks, keys=("0", "1"), model=TINY, **options):
    benchmark = Benchmark("drawn", DATA, tuple(keys), (), (5,))
    options = {"engine": "serial", "progress": False, **options}
    return rf.evaluate(model, benchmark, None, folder, attacks=attacks, **options)


def _rows(run):
    return run.attack_rows.sort("sample", "corruption")


def _column(run, name, column):
    return dict(run.attack_rows.filter(corruption=name).select("sample", column).iter_rows())


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of trained attacks, alone and inside composite attacks, on two of four samples."""
    return _run(tmp_path_factory.mktemp("runs") / "run", TRAINED)


def test_a_trained_attack_is_trained_once_on_samples_that_are_not_measured(trained):
    assert set(trained.attack_rows["corruption"]) >= {*TRAINED, "random_patch"}
    assert set(trained.manifest.identity.frames.attack_sources) == set(TRAINED)
    # the part of worst_of is the attack alone
    assert len(list((trained.path / "attacks").glob("*.npy"))) == 3
    lines = [line.label for section in attack_table(numbers_of(trained)).sections for line in section.lines]
    assert {f"{UNIVERSAL} 5", f"{PATCH} 5", "random_patch 5"} <= set(lines)


def test_a_trained_attack_inside_a_transfer_is_trained_on_the_surrogate(trained):
    # the surrogate is the attacked model
    assert _column(trained, INSIDE, "frames_digest") == _column(trained, UNIVERSAL, "frames_digest")


def test_a_trained_attack_inside_worst_of_is_one_of_its_candidates(trained, tmp_path):
    parts = [_column(trained, name, "epe_sum") for name in ("random_sign", UNIVERSAL)]
    worst = {sample: max(part[sample] for part in parts) for sample in ("0", "1")}
    assert _column(trained, WORST, "epe_sum") == worst
    assert _column(_run(tmp_path / "run", WORST), WORST, "epe_sum") == worst, "requested alone"


def test_stored_perturbation_is_reused_if_intact_and_trained_again_if_damaged(trained, monkeypatch):
    before, asked = _rows(trained), []
    for kind in (Universal, patch.Patch):
        monkeypatch.setattr(kind, "learn", lambda *given, learn=kind.learn: asked.append(1) or learn(*given))

    def again():
        for shard in (trained.path / "rows").iterdir():
            shard.unlink()
        return _rows(_run(trained.path, TRAINED))

    assert again().equals(before)
    assert not asked
    (path,) = (trained.path / "attacks").glob("universal*")
    damaged = bytearray(path.read_bytes())
    damaged[200] ^= 1
    path.write_bytes(damaged)
    assert again().equals(before)
    assert asked == [1]


@pytest.mark.parametrize("shape", [(1,), (3, 5, 9), (2, 3, 0, 4), (2, 4, 40, 48), (3, 3, 3, 3)])
def test_an_array_that_is_no_perturbation_is_trained_again(tmp_path, shape):
    names = {"universal:train=1:steps=1": (2, 3, 40, 48), "patch:train=1:steps=1": (3, 10, 10)}
    benchmark = Benchmark("drawn", DATA, ("0",), (), (5,), attacks=tuple(names))
    plan, folder = set_up(TINY, benchmark), RunFolder(tmp_path)
    for name in names:
        path = folder.pattern_path(name, 5)
        path.parent.mkdir(exist_ok=True)
        write_array(path, np.zeros(shape, np.float32), f"{plan.identity.digest()} {name} 5")
    attacks = trained_attacks(folder, plan, [Unit("0", name, (5,)) for name in names])
    assert {name: one.learned[5].shape for name, one in attacks.items()} == names


def test_worker_processes_use_the_perturbation_that_was_trained_once(trained, tmp_path):
    spread = _run(tmp_path / "run", TRAINED, engine="processes", workers=1)
    assert _rows(spread).equals(_rows(trained))


def test_perturbation_file_of_a_run_works_on_a_model_without_gradients(trained, tmp_path):
    (path,) = (trained.path / "attacks").glob("universal*")
    name = f"universal:file={path}"
    moved = _run(tmp_path / "run", name, model=ModelRef.parse("dis"))
    assert _column(moved, name, "frames_digest") == _column(trained, UNIVERSAL, "frames_digest")


def test_samples_are_never_both_measured_and_trained_on(tmp_path):
    keys = tmp_path / "keys.txt"
    keys.write_text("1\n3\n")
    for train in (keys, 3):  # sample 1 is measured, and only two are not
        refusal(partial(_run, tmp_path / "run", f"universal:train={train}"), UsageError, f"universal:train={train}")
    assert not (tmp_path / "run").exists()


def test_run_with_changed_training_samples_is_refused(trained):
    assert "train=2" in str(refusal(lambda: _run(trained.path, TRAINED, keys=DATA.keys()[2:]), RunError, trained.path))
