"""Compare attacks with the outputs of FlowBench's and PCFA's code, to the tolerances in the READMEs of the parity
packs."""

import json

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

from robustflow import TorchModel
from robustflow.attacks import load_attack
from robustflow.attacks.ball import Ball
from robustflow.attacks.loss import Loss
from robustflow.attacks.pcfa import _Search
from robustflow.attacks.pgd import climb
from robustflow.attacks.problem import Pair, Problem
from robustflow.core.rng import Rng

from ..parity.pack import Pack
from ..shared_data import shared_root
from .smooth_net import SmoothNet

SIGN, PCFA = "attack_fgsm_bim_pgd_cospgd", "attack_pcfa"


def _cases(folder: str) -> list[dict]:
    """The cases of the smooth network."""
    path = shared_root() / "parity" / folder / "cases.json"
    if not path.is_file():
        return [pytest.param(None, marks=pytest.mark.skip(reason=f"shared data 'parity/{folder}' not found"))]
    cases = json.loads(path.read_text())["cases"]
    cases = cases["tiny"] if isinstance(cases, dict) else [case for case in cases if case["name"].startswith("tiny")]
    return [pytest.param(case, id=case["name"]) for case in cases]


def _smooth(pack: Pack) -> TorchModel:
    return TorchModel(
        pack.fill(SmoothNet(), "keys_tiny.json"), scaling="0-1", order="rgb", layout="pair", multiple=1, device="cpu"
    )


def _truth(pack: Pack) -> Loss:
    with np.load(pack.folder / "tiny_truth.npz") as arrays:
        return Loss(arrays["flow"][0].transpose(1, 2, 0), arrays["valid"][0].astype(bool))


def _problem(pack: Pack, case: dict) -> Problem:
    frames = [pack.frame(f"tiny_{i}") for i in (1, 2)]
    truth = _truth(pack).reference
    height, width = truth.shape[:2]
    norm = "rms" if case.get("norm") == "two" else "linf"
    unit = 255 / np.sqrt(3 * height * width) if norm == "rms" else 255
    ball = Ball(*frames, case["eps"] * unit, norm, per_frame=True)
    problem = Problem(_smooth(pack), ball, Loss(truth), Pair(tuple(frames), ball.budget), truth)
    clean = problem.flow(ball.clean)
    reference = {"zero": np.zeros_like(clean), "negative": -clean}.get(case.get("target", ""), truth)
    reference = clean if case.get("optim") == "initial_flow" else reference
    kind, agreeing = case.get("loss", "epe"), case["attack"] == "cospgd"
    problem.loss = Loss(reference, None, kind, towards="target" in case, agreeing=agreeing)
    problem.trace.clear()
    return problem


def _expected(pack: Pack, name: str) -> dict[str, np.ndarray]:
    arrays = {}
    for path in sorted(pack.folder.glob("tiny_expected*.npz")):
        with np.load(path) as file:
            arrays |= {key.removeprefix(f"{name}."): file[key] for key in file.files if key.startswith(f"{name}.")}
    return arrays


def _run(problem: Problem, case: dict, start, losses: list[float]):
    """Run the attack as FlowBench does; the loss before each step, with CosPGD's weight, is appended to `losses`."""
    asked = problem.loss_and_gradient

    def noted(images):
        answer = asked(images)
        losses.append(answer[0])
        return answer

    problem.loss_and_gradient = noted
    unit = problem.ball.budget / case["eps"]
    if case["attack"] == "fgsm":
        return load_attack("fgsm", variant="flowbench", norm=problem.ball.norm).run(problem, Rng.of(0))
    size = problem.ball.budget if case["attack"] == "bim" else case["alpha"] * unit
    assert case["attack"] != "bim" or load_attack("bim", variant="flowbench", steps=1).step_sizes(3.5) == [3.5]
    images = problem.ball.clean if case["attack"] == "bim" else start
    images = climb(problem, images, [size] * case["iters"], keep_best=False)
    losses.append(problem.trace[-1])
    return images


@pytest.mark.parametrize("case", _cases(SIGN))
def test_sign_attacks_on_the_smooth_network_follow_flowbench(shared, case):
    pack = Pack(shared(f"parity/{SIGN}"))
    problem = _problem(pack, case)
    expected = _expected(pack, case["name"])
    starts = _expected(pack, f"pgd_{case['norm']}_gt")
    singular = case["name"] == "pgd_inf_initial"
    if "grad0" in expected:
        begin = starts["start"] if case["attack"] in ("pgd", "cospgd") else problem.ball.clean
        gradient = problem.loss_and_gradient(begin)[2]
        assert np.abs(gradient - expected["grad0"]).max() <= 1e-4 * np.abs(expected["grad0"]).max()
    losses: list[float] = []
    images = _run(problem, case, starts.get("start"), losses)
    assert np.allclose(losses, expected["loss"], rtol=5e-3 if singular else 1e-5, atol=0)
    assert np.mean(np.abs(images - expected["adv"]) > 1e-6) <= (0.1 if singular else 0.002)
    flow = problem.flow(images)
    assert np.abs(flow.transpose(2, 0, 1) - expected["flow_after"][0]).max() <= (3 if singular else 0.2)
    assert abs(_truth(pack).of(flow) - expected["epe_gt"][-1]) <= (0.05 if singular else 1e-3)


def _pcfa(pack: Pack, case: dict) -> tuple[_Search, Problem, list[float]]:
    attack = load_attack(
        "pcfa",
        variant="original",
        target="zero" if case["target"] == "zero" else "negative",
        box="clipping" if case.get("box") == "clipping" else "change",
        moved="joint" if case.get("joint") else "both",
        steps=case["steps"],
    )
    problem = _problem(pack, {"attack": "pcfa", "eps": 1.0})
    ball = Ball(problem.ball.frame1, problem.ball.frame2, case["bound"] * 255, "rms", attack.moved)
    problem.ball = ball
    clean = problem.flow(ball.clean)
    reference = -clean if attack.target == "negative" else np.zeros_like(clean)
    kind = {"aee": "epe"}.get(case.get("loss", "aee"), case.get("loss", "aee"))
    problem.loss = Loss(reference, None, kind, towards=True)
    search = _Search(attack, problem)
    objectives: list[float] = []
    asked = search.objective

    def noted(keep: bool = False) -> float:
        # the original evaluates the starting point of LBFGS once more
        objectives.extend([value := asked(keep)] * (1 + keep))
        return value

    search.objective = noted
    return search, problem, objectives


@pytest.mark.slow
@pytest.mark.parametrize("case", _cases(PCFA))
def test_pcfa_on_the_smooth_network_follows_the_original(shared, case):
    pack = Pack(shared(f"parity/{PCFA}"))
    search, problem, objectives = _pcfa(pack, case)
    expected, joint, strict = _expected(pack, case["name"]), case.get("joint", False), case["strict"]
    search.run(case["steps"])
    few = 6 if joint else 11 * strict
    assert np.allclose(objectives[:few], expected["loss_evals"][:few], rtol=1e-4 if joint else 1e-5, atol=0)
    size = problem.ball.size_of(search.kept - problem.ball.clean)
    assert size <= case["bound"] * (1 + 1e-6)
    distance = Loss(problem.loss.reference).of(problem.flow(search.kept))
    assert distance == pytest.approx(expected["aee_adv_tgt_best"][-1], rel=0.01)
    search, problem, _ = _pcfa(pack, case)
    search.run(strict)
    images, change = (tensor.detach().numpy() for tensor in search._pair())
    for number in (1, 2):
        found = change[number - 1]
        assert np.abs(found - expected[f"step{strict}_delta{number}_final"][0]).max() <= (1e-4 if joint else 3e-6)
    flow = problem.flow(np.ascontiguousarray(images)).transpose(2, 0, 1)
    assert np.abs(flow - expected[f"step{strict}_flow_pred_final"][0]).max() <= (1e-3 if joint else 2e-4)
