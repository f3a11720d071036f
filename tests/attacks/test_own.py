"""The user's own attacks: their contract, their effect on a run's identity, and the problems that the checker
reports."""

from __future__ import annotations

import pickle
import sys
import threading
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks import Attack, load_attack
from robustflow.attacks.api import with_controls
from robustflow.core.errors import RunError, UsageError
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelRef
from robustflow.testing import TexturePairs, check_attack

from ..refusals import refusal

DATA = TexturePairs(1, (40, 48))
FRAMES = [np.random.default_rng(number).integers(0, 256, (24, 32, 3), np.uint8) for number in range(2)]


class Noise:
    """Tries a few random sign patterns and keeps the best."""

    needs_gradients = False

    def __init__(self, tries: int = 3) -> None:
        self.tries = tries

    def run(self, problem, rng):
        for _ in range(self.tries):
            problem.query(self.drawn(problem.ball, rng))
        return problem.best

    def drawn(self, ball, rng):
        signs = np.sign(rng.uniforms(ball.clean.size) - 0.5).astype(np.float32).reshape(ball.clean.shape)
        return ball.project(ball.clean + ball.radius * signs)


class Locked(Noise):
    """A class whose objects cannot be sent to other processes."""

    def __init__(self, tries: int = 3) -> None:
        super().__init__(tries)
        self.lock = threading.Lock()


def _model(frame1, frame2):
    return ((frame1.astype(np.float32) - frame2) * frame1)[..., :2] / 3000


@pytest.fixture
def source(tmp_path, monkeypatch):
    """Write `my_noise.py` with the attack class `Mine`, and unload the module to imitate a new process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def write(text: str = "") -> None:
        sys.modules.pop("my_noise", None)
        (tmp_path / "my_noise.py").write_text(
            f"from tests.attacks.test_own import Noise\nclass Mine(Noise): ...\n{text}"
        )

    write()
    yield write
    sys.modules.pop("my_noise", None)


def _run(attacks, output="run", engine="serial", **options):
    benchmark = Benchmark("drawn", DATA, DATA.keys(), (), (2,))
    return rf.evaluate(
        ModelRef.parse("dis"), benchmark, None, output, attacks=attacks, engine=engine, progress=False, **options
    )


def test_an_attack_is_sent_to_a_process_without_what_it_has_built():
    own = load_attack(Locked, tries=2, moved="first")
    assert pickle.loads(pickle.dumps(own)).label == own.label == "locked:moved=first:tries=2"
    transfer = load_attack("transfer:dis:attack=square")
    transfer.check(rf.load_model("dis"))
    assert "_surrogate" in vars(transfer)
    sent = pickle.loads(pickle.dumps(transfer))
    assert sent == transfer
    assert "_surrogate" not in vars(sent)


def test_an_own_attack_is_a_condition_with_its_options_and_its_source(source):
    name = "mine:moved=first:tries=2"
    done = _run("my_noise:Mine:tries=2:moved=first")
    rows = done.attack_rows.filter(corruption=name)
    assert rows["attack_evaluations"].to_list() == [2]
    assert list(done.manifest.identity.frames.attack_sources) == [name]
    source("VALUE = 1\n")
    assert name in str(refusal(lambda: _run("my_noise:Mine:tries=2:moved=first"), RunError, done.path))


def test_an_own_attack_in_processes_gives_the_same_rows(source):
    here = _run("my_noise:Mine").attack_rows
    there = _run("my_noise:Mine", "other", "processes", workers=1).attack_rows
    assert there.sort("corruption").equals(here.sort("corruption"))


def test_nothing_is_imported_for_a_name_that_no_request_made(source):
    refusal(lambda: load_attack("my_noise:Mine"), UsageError, "my_noise")
    assert "my_noise" not in sys.modules


def test_an_own_attack_is_part_of_others():
    load_attack(Noise)
    worst = rf.attack(*FRAMES, _model, "worst_of:noise+random_sign", 3)
    alone = [rf.attack(*FRAMES, _model, each, 3).loss for each in (Noise, "random_sign")]
    assert worst.loss == max(alone)


def test_a_subclass_of_attack_has_options_as_fields_and_a_source():
    @dataclass(frozen=True, kw_only=True)
    class Still(Attack):
        name: ClassVar[str] = "still"
        needs_gradients: ClassVar[bool] = False
        amount: int = 1
        norm: str = "rms"

        def run(self, problem, rng):
            return problem.ball.project(problem.ball.clean + np.float32(self.amount / 255))

    made = load_attack(Still, amount="2")
    assert (made.amount, made.label) == (2, "still:amount=2:norm=rms")
    assert len(made.source) == 16
    assert load_attack(made.label) == made
    assert load_attack(load_attack(Still(amount=3)).label) == Still(amount=3), "an instance is registered too"


def kind(name="Any", **attributes):
    return type(name, (), {"needs_gradients": False, "run": lambda *_: 0, **attributes})


@pytest.mark.parametrize(
    ("made", "culprit"),
    [
        (max, "the function max"),
        (kind(name="two words"), "two words"),
        (kind(name="pgd"), "pgd"),
        (kind("Bad", __init__=lambda self, size: None), "bad"),
    ],
)
def test_object_that_is_not_an_attack_is_refused(made, culprit):
    refusal(lambda: load_attack(made), UsageError, culprit)


@pytest.mark.parametrize(
    ("run", "culprit"),
    [
        (lambda problem, rng: None, "wrong"),
        (lambda problem, rng: problem.ball.clean.astype(np.float64), "wrong"),
        (lambda problem, rng: problem.ball.clean * np.float32(np.nan), "wrong"),
        (lambda problem, rng: problem.ball.clean.fill(0), "wrong"),
        (lambda problem, rng: problem.pair.frames[0].fill(0), "wrong"),
        (lambda problem, rng: problem.pair.truth.fill(0), "wrong"),
        (lambda problem, rng: problem.pair.valid.fill(0), "wrong"),
        (lambda problem, rng: problem.clean_flow.fill(0), "wrong"),
        (lambda problem, rng: 1 / 0, "wrong"),
    ],
)
@pytest.mark.parametrize("base", [object, Attack])
def test_error_in_an_own_attack_ends_the_run(run, culprit, base):
    wrong = type("Wrong", (base,), {"name": "wrong", "needs_gradients": False, "run": staticmethod(run)})
    truth, valid = np.ones((24, 32, 2), np.float32), np.ones((24, 32), bool)
    refusal(lambda: rf.attack(*FRAMES, _model, wrong, 3, flow=truth, valid=valid), UsageError, culprit)
    assert truth.all()
    assert valid.all()


def test_two_attacks_of_one_name_cannot_be_in_one_run():
    first = Noise()
    assert with_controls([first, first, "noise"])[-1] == "noise"
    refusal(lambda: with_controls([first, Noise()]), UsageError, "noise")


class InOneArray(Noise):
    """Scores a random pair and then the clean pair in the same array."""

    def run(self, problem, rng):
        images = self.drawn(problem.ball, rng)
        scores = [problem.score(images)]
        images[:] = problem.ball.clean
        scores.append(problem.score(images))
        assert scores[0] > scores[1]
        return problem.best


@pytest.mark.torch
def test_an_attack_that_overwrites_its_images_keeps_the_best_pair():
    pytest.importorskip("torch", reason="needs the torch extra")
    from .smooth_net import Given

    model = Given(lambda images1, images2: 30 * ((images1 - images2) * images1)[:, :2])
    assert rf.attack(*FRAMES, model, InOneArray, 3).linf == 4


class Far(Noise):
    def run(self, problem, rng):
        return np.clip(self.drawn(problem.ball, rng) + np.float32(0.2), 0, 1)


class Last(Noise):
    def run(self, problem, rng):
        super().run(problem, rng)
        return problem.ball.clean.copy()


class Unseeded(Noise):
    def run(self, problem, rng):
        noise = np.random.default_rng().normal(size=problem.ball.clean.shape).astype(np.float32)
        return problem.ball.project(problem.ball.clean + noise)


@pytest.mark.parametrize("made", [Far, Last, Unseeded])
def test_check_attack_finds_a_broken_contract(made):
    refusal(lambda: check_attack(made), UsageError, made.__name__.lower())


def test_check_attack_accepts_every_shipped_attack():
    pytest.importorskip("torch", reason="needs the torch extra")
    assert check_attack(Noise) == "noise"
    for name in ("random_gauss", "fgsm", "apgd:steps=5", "square:queries=5"):
        assert check_attack(name) == name.partition(":")[0]
