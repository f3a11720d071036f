"""Attack a pair of frames by name."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from ..errors import DataError, ModelError, UsageError, unknown_name
from ..models.base import AnyModel, FlowModel, predict_checked
from ..models.construct import as_model
from ..models.loading import load_model
from ..random.rng import Rng
from ..sample import Flow, Frame, Mask, Sample
from ..severity import check_severity
from .ball import Ball
from .base import Attack
from .images import frames_of
from .loss import Loss
from .problem import Problem, refuse_without_gradient
from .registry import ATTACKS
from .result import Attacked, norms_of

_LAST_QUARTER = 0.02
_ROUNDING = 0.05


def list_attacks() -> list[str]:
    """Return the names that `load_attack` knows, the controls first, those of installed packages last.

    >>> list_attacks()[:3]
    ['random_sign', 'random_gauss', 'fgsm']
    """
    return list(ATTACKS.names())


def load_attack(name: str | Attack, **options: Any) -> Attack:
    """An attack with options, see its class.

    Raises:
        UsageError: unknown name or option.

    >>> load_attack("pgd", steps=10).budget(3)
    4
    >>> load_attack("pgd", step=10)
    Traceback (most recent call last):
    robustflow.errors.UsageError: unknown option of attack pgd 'step': did you mean 'steps'? Known: variant, norm, \
target, loss, reference, moved, steps, starts
    """
    if isinstance(name, Attack):
        if options:
            raise UsageError(f"the attack {name.name} is already built, so it takes no options: {', '.join(options)}")
        return name
    kind = ATTACKS.get(name)
    known = [each.name for each in fields(kind)]
    for option in options:
        if option not in known:
            raise unknown_name(f"option of attack {name}", option, known)
    return kind(**options)


def attack(
    frame1: Frame,
    frame2: Frame,
    model: Any,
    name: str | Attack = "apgd",
    severity: int | None = None,
    *,
    budget: float | None = None,
    flow: Flow | None = None,
    valid: Mask | None = None,
    seed: int = 0,
    key: str = "",
    **options: Any,
) -> Attacked:
    """Attack one pair of frames.

    Args:
        frame1, frame2: RGB uint8 (H, W, 3) of one size.
        model: a name as of `load_model`, or an object as `evaluate` takes it.
        name: of the attack (`robustflow list attacks`), or one from `load_attack`.
        severity: 1 (mild) to 5 (severe); 3 by default.
        budget: grey levels of 255, instead of a severity.
        flow: ground truth, float32 (H, W, 2), pixels, which an attack without a target moves the flow away from; the
            model's own flow of the clean frames if it is not given.
        valid: bool (H, W), where the ground truth is known; everywhere by default.
        seed: of the random choices; with `key`, the name of the pair, and the severity it names their stream.
        options: of the attack.

    Returns:
        The attacked frames, as a file would hold them, with flows, norms and costs.

    Raises:
        UsageError: unknown attack or option, severity and budget together, or a mask without flow.
        ModelError: the model offers no gradient and the attack needs one.
        DataError: frames that are not RGB uint8 of one size, or ground truth that does not fit them.

    >>> import robustflow as rf
    >>> frame = (np.arange(64 * 96 * 3) % 251).astype(np.uint8).reshape(64, 96, 3)
    >>> attacked = rf.attack(frame, np.roll(frame, 2, 1), "dis", "square", severity=2, queries=20)
    >>> attacked.linf, attacked.evaluations
    (2.0, 20)
    """
    if severity is not None and budget is not None:
        raise UsageError("give a severity or a budget, not both")
    chosen = load_attack(name, **options)
    loaded = load_model(model) if isinstance(model, str) else as_model(model, "the model")
    if not isinstance(loaded, FlowModel):
        raise ModelError("only a model of two frames, with predict(frame1, frame2), can be attacked")
    _check(frame1, frame2, flow, valid)
    level = 0 if budget is not None else check_severity(3 if severity is None else severity)
    grey = chosen.budget(level) if budget is None else budget
    rng = _stream(chosen, level, seed, key)
    clean_flow = predict_checked(loaded, (frame1, frame2), key, "clean", 0)
    return attack_pair(chosen, loaded, (frame1, frame2), clean_flow, grey, rng, flow, valid, key)


def attack_of_sample(
    attack: Attack, model: AnyModel, sample: Sample, clean_flow: Flow, severity: int, seed: int
) -> Attacked:
    """What `attack` gives for a sample, whose key names the random choices, with the clean flow known.

    Args:
        attack: with its options.
        model: loaded.
        sample: with ground truth or without.
        clean_flow: of its frames, float32 (H, W, 2), pixels.
        severity: 1 to 5.
        seed: of the random choices.

    Raises:
        ModelError: see `attack`.
    """
    rng = _stream(attack, severity, seed, sample.key)
    first, second = sample.frames[:2]
    budget = attack.budget(severity)
    return attack_pair(attack, model, (first, second), clean_flow, budget, rng, sample.flow, sample.valid, sample.key)


def _stream(attack: Attack, severity: int, seed: int, key: str) -> Rng:
    return Rng.of(seed, "attack", attack.name, severity, key)


def attack_pair(
    attack: Attack,
    model: AnyModel,
    clean: tuple[Frame, Frame],
    clean_flow: Flow,
    budget: float,
    rng: Rng,
    flow: Flow | None,
    valid: Mask | None,
    key: str,
) -> Attacked:
    """Attack a pair whose clean flow is known.

    Args:
        attack: with its options.
        model: with `predict`, loaded.
        clean: RGB uint8 (H, W, 3) each.
        clean_flow: of these frames, float32 (H, W, 2), pixels.
        budget: grey levels.
        rng: for this pair, attack and severity.
        flow, valid: ground truth as in `attack`, or None.
        key: of the sample, for messages.

    Raises:
        UsageError: the attack wants ground truth and there is none.
        ModelError: see `attack`.
    """
    ball = Ball(*clean, budget, attack.norm, attack.moved, attack.per_frame)
    loss, from_clean = _loss(attack, clean_flow, flow, valid)
    problem = Problem(model, ball, loss, key, from_clean)
    if attack.needs_gradients:
        refuse_without_gradient(model, attack.name)
    images = attack.run(problem, rng)
    evaluations, gradients = problem.evaluations, problem.gradients
    frames = frames_of(ball.to_8_bits(images))
    assert isinstance(model, FlowModel)
    after = predict_checked(model, frames, key, attack.name, 0)
    clean_loss, here = loss.of(clean_flow, weighted=False), loss.of(after, weighted=False)
    float_loss = problem.loss_at(images) if attack.needs_gradients else None
    linf, rms, changed = norms_of(frames, clean)
    return Attacked(
        attack=attack.name,
        budget=budget,
        norm=attack.norm,
        frames=frames,
        flow=after,
        clean_flow=clean_flow,
        images=images,
        loss=here,
        clean_loss=clean_loss,
        float_loss=float_loss,
        linf=linf,
        rms=rms,
        changed=changed,
        trace=tuple(problem.trace),
        evaluations=evaluations,
        gradients=gradients,
        warnings=tuple(sorted(problem.troubles | _doubts(problem, clean_loss, here, float_loss))),
    )


def _loss(attack: Attack, clean_flow: Flow, flow: Flow | None, valid: Mask | None) -> tuple[Loss, bool]:
    """The loss of an attack on a pair, and whether it is the distance to the clean flow."""
    if attack.target != "none":
        target = -clean_flow if attack.target == "negative" else np.zeros_like(clean_flow)
        return Loss(target, None, attack.loss, towards=True, agreeing=attack.agreeing), False
    if flow is None or attack.reference == "clean":
        if attack.reference == "truth":
            raise UsageError(
                f"attack {attack.name} moves the flow away from the ground truth, and there is none; give the flow, or "
                "leave out reference=truth"
            )
        return Loss(clean_flow, None, attack.loss, agreeing=attack.agreeing), True
    if attack.masked:
        return Loss(flow, valid, attack.loss, agreeing=attack.agreeing), False
    filled = flow if valid is None else np.where(valid[..., None], flow, np.float32(0))
    return Loss(filled, None, attack.loss, agreeing=attack.agreeing), False


def _doubts(problem: Problem, clean_loss: float, loss: float, float_loss: float | None) -> set[str]:
    """What the course of the attack says against its number."""
    doubts = set()
    trace = [problem.loss.score(value) for value in problem.trace]
    last = len(trace) - len(trace) // 4
    if len(trace) >= 8 and max(trace) - max(trace[:last]) > _LAST_QUARTER * abs(max(trace) - trace[0]):
        doubts.add("still_rising")
    if float_loss is not None and abs(loss - float_loss) > _ROUNDING * abs(float_loss - clean_loss):
        doubts.add("rounding")
    return doubts


def _check(frame1: Frame, frame2: Frame, flow: Flow | None, valid: Mask | None) -> None:
    for frame in (frame1, frame2):
        is_frame = isinstance(frame, np.ndarray) and frame.dtype == np.uint8 and frame.ndim == 3
        if not is_frame or frame.shape[2] != 3 or frame.shape != frame1.shape:
            raise DataError("an attack takes two RGB uint8 frames (H, W, 3) of one size")
    if valid is not None and flow is None:
        raise UsageError("a mask of valid pixels belongs to a ground truth; give the flow, too")
    if flow is not None and flow.shape != (*frame1.shape[:2], 2):
        raise DataError(f"the ground truth is {flow.shape}; expected {(*frame1.shape[:2], 2)}, as the frames")
    if valid is not None and (valid.shape != frame1.shape[:2] or valid.dtype != bool):
        raise DataError(f"the mask is {valid.dtype} {valid.shape}; expected bool {frame1.shape[:2]}")
