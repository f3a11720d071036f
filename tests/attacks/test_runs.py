"""Attacks as conditions of a run: rows, resuming and engines."""

import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks.api import with_controls
from robustflow.attacks.registry import ATTACKS, SHIPPED, attack_spec
from robustflow.core.errors import ModelError, RunError, UsageError
from robustflow.models import ModelRef
from robustflow.report.attack_tables import attack_table
from robustflow.run.run import Run
from robustflow.run.stages import frames_digest
from robustflow.testing import TexturePairs, ZeroFlow

from ..refusals import refusal
from . import killed_run
from .small_runs import DATA, TINY, every, numbers_of, run, still

pytest.importorskip("torch", reason="needs the torch extra")


def test_attacks_are_rows_of_the_same_run_with_the_noise_of_their_norm(both):
    cells = {(row["corruption"], row["severity"]) for row in both.attack_rows.iter_rows(named=True)}
    assert both.attacks == ["random_sign", "random_gauss", "fgsm", "pgd"]
    assert cells == {("clean", 0), *((name, level) for name in both.attacks for level in (1, 3))}
    assert both.attack_rows.height == 2 * len(cells)
    assert both.manifest.finished is not None


def test_no_mean_over_corruptions_includes_an_attack(both, tmp_path):
    alone = run(tmp_path / "alone", attacks=None, corruptions=["contrast", "high_light"])
    assert both.means == alone.means
    assert both.rows.equals(alone.rows)
    assert both.document() == alone.document()


def test_a_row_of_an_attack_is_of_the_pair_that_the_function_gives(both):
    sample, model = DATA.load("1"), TINY.load()
    attacked = rf.attack(*sample.frames, model, "pgd", 3, flow=sample.flow, valid=sample.valid, key="1")
    row = both.attack_rows.filter(sample="1", corruption="pgd", severity=3).row(0, named=True)
    assert row["frames_digest"] == frames_digest(attacked.frames)
    assert row["attack_linf"] == attacked.linf == 4
    assert (row["attack_rms"], row["attack_evaluations"]) == (attacked.rms, attacked.evaluations)
    assert (row["attack_gradient"], attacked.gradients) == ("whole", 3 * 20 + 1)
    assert row["attack_warnings"] == (",".join(attacked.warnings) or None)
    assert row["epe_sum"] / row["n_valid"] == pytest.approx(attacked.loss, rel=1e-6)
    error = np.linalg.norm(attacked.flow.astype(float) - sample.flow, axis=-1)[sample.valid]
    assert row["attack_capped_sum"] == pytest.approx(np.minimum(error, np.hypot(40, 48)).sum())
    assert row["attack_median"] == pytest.approx(np.median(error))
    assert row["attack_way_gone"] is None
    assert row["attack_late_gain"] == attacked.late_gain >= 0
    assert row["attack_start_spread"] == attacked.start_spread > 0


def test_attacks_added_later_give_the_rows_of_one_call(both, tmp_path):
    run(tmp_path / "run", attacks="fgsm", severities=1, count=1)
    run(tmp_path / "run", attacks=None, corruptions=["contrast", "high_light"])
    run(tmp_path / "run", attacks=["fgsm", "pgd"])
    assert every(Run(tmp_path / "run")).equals(every(both))


def test_processes_and_this_process_give_the_same_rows(both, tmp_path):
    spread = run(tmp_path / "run", corruptions=["contrast", "high_light"], engine="processes", workers=2, batch_size=2)
    assert every(spread).equals(every(both))


def test_a_model_without_gradients_is_refused_before_anything_is_computed(tmp_path):
    refusal(lambda: run(tmp_path / "run", ModelRef.parse("dis")), ModelError, "dis")
    assert not (tmp_path / "run").exists()


def test_attacks_on_an_accelerator_stay_in_this_process(tmp_path, monkeypatch):
    from robustflow.run.config import Compute, RunConfig
    from robustflow.run.engines.choose import choose_engine
    from robustflow.run.plan import Plan, name_model

    def chosen(**compute):
        benchmark = rf.Benchmark("drawn", DATA, ("0",), (), attacks=("square",))
        return choose_engine(Plan(benchmark, name_model(TINY), RunConfig(compute=Compute(**compute))))

    monkeypatch.setattr("robustflow.run.engines.choose.devices_of", lambda spec, model: ("cuda:0",))
    assert chosen().describe([]).startswith("serial")
    refusal(lambda: chosen(engine="processes"), UsageError, "--engine")


def test_a_variant_changes_the_attacks_that_have_it(both, tmp_path):
    flowbench = run(tmp_path / "run", variant="flowbench", severities=1)
    digests = {
        name: [
            result.attack_rows.filter(corruption=name, severity=1).sort("sample")["frames_digest"].to_list()
            for result in (both, flowbench)
        ]
        for name in ("random_sign", "fgsm", "pgd")
    }
    assert digests["random_sign"][0] == digests["random_sign"][1]
    assert digests["pgd"][0] != digests["pgd"][1]
    assert flowbench.manifest.identity != both.manifest.identity


def test_options_and_other_models_are_part_of_a_rows_name_and_of_the_identity(tmp_path):
    names = ["pgd:target=zero:steps=2", "pgd:moved=joint:steps=3", "transfer:tiny:attack=fgsm:device=cpu"]
    done = run(tmp_path / "run", attacks=names, severities=3, count=1)
    rows = {row["corruption"]: row for row in done.attack_rows.iter_rows(named=True)}
    assert set(rows) == {"clean", "random_sign", "random_gauss", *names}
    assert all(rows[name]["attack_evaluations"] > own for name, own in zip(names, (9, 12, 1), strict=True))
    sources = done.manifest.identity.frames.attack_sources
    assert list(sources) == [names[2]]
    fgsm = run(tmp_path / "fgsm", attacks="fgsm", severities=3, count=1)
    same = fgsm.attack_rows.filter(corruption="fgsm")["frames_digest"][0]
    assert (
        rows[names[2]]["frames_digest"] == same
    )  # the surrogate is the model itself, so the transferred attack equals the attack
    without = partial(run, tmp_path / "run", attacks="fgsm", severities=3, count=1)
    assert names[2] in str(refusal(without, RunError, tmp_path / "run"))
    assert {line.label for section in attack_table(numbers_of(done)).sections for line in section.lines} >= {
        f"{names[0]} 3"
    }


def test_run_with_a_changed_surrogate_is_refused(tmp_path, monkeypatch):
    name, model = "transfer:tiny:attack=fgsm:device=cpu", TINY.load()
    run(tmp_path / "run", model, attacks=name, severities=3, count=1)
    monkeypatch.setattr("robustflow.attacks.composed.ModelRef.identity", lambda spec, model: {"weights": "new"})
    again = partial(run, tmp_path / "run", model, attacks=name, severities=3, count=1)
    assert name in str(refusal(again, RunError, tmp_path / "run"))


@pytest.mark.parametrize("options", [{"attacks": "pdg"}, {"variant": "theirs"}, {"attacks": [], "corruptions": []}])
def test_invalid_attacks_of_a_run_are_refused(tmp_path, options):
    with pytest.raises(UsageError):
        run(tmp_path / "run", **options)


def test_the_norm_of_each_attack_is_that_of_its_class():
    from robustflow.attacks import load_attack

    assert {name: attack_spec(name).norm for name in SHIPPED} == {name: load_attack(name).norm for name in SHIPPED}
    assert with_controls(["pgd"]) == ("random_sign", "random_gauss", "pgd")


def test_attack_without_gain_warns_and_a_control_does_not():
    frames = TexturePairs(1).load("0").frames
    truth = np.ones((*frames[0].shape[:2], 2), np.float32)
    square, noise = (
        rf.attack(*frames, ZeroFlow(), each, 3, flow=truth) for each in ("square:queries=3", "random_sign")
    )
    assert (square.warnings, noise.warnings) == (("nothing_gained",), ())


PLANTED = """
from dataclasses import dataclass
from typing import ClassVar
from robustflow.attacks import Attack

@dataclass(frozen=True, kw_only=True)
class Planted(Attack):
    name: ClassVar[str] = "planted"
    needs_gradients: ClassVar[bool] = False
    amount: int = 1

    def run(self, problem, rng):
        return problem.ball.project(problem.ball.clean + self.amount / 255)
"""


def test_an_attack_is_one_file_and_a_line_of_the_registry(tmp_path, monkeypatch):
    (tmp_path / "planted_attack.py").write_text(PLANTED)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(ATTACKS._targets, "planted", "planted_attack:Planted")
    done = run(tmp_path / "run", still, attacks="planted:amount=2", severities=3, count=1)
    assert "planted" in rf.list_attacks()
    assert done.attack_rows.filter(corruption="planted:amount=2")["attack_linf"].to_list() == [2]
    lines = [line.label for section in attack_table(numbers_of(done)).sections for line in section.lines]
    assert "planted:amount=2 3" in lines


def test_a_run_killed_in_its_attacks_continues_with_the_same_rows(tmp_path):
    """SIGKILL arrives during an attack on the first pair, then during one on the second; the last run is not
    interrupted."""
    script = [sys.executable, killed_run.__file__, str(tmp_path / "killed"), "20", "45"]
    subprocess.run(script, check=True, timeout=300)
    whole = killed_run.run(tmp_path / "whole", 0)
    killed = rf.load_run(tmp_path / "killed")
    assert every(killed).equals(every(whole))
    assert killed.attack_rows.filter(corruption="square:queries=9").height == 4
