"""Attack a pair of frames with an attack given by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..core.arguments import check_severity
from ..core.errors import DataError, ModelError, UsageError
from ..core.types import Flow, Frame, Mask, Sample, check_frame, described_array
from ..models.calls import predict_checked
from ..models.loading import load_model
from ..models.objects import as_model
from ..models.protocols import AnyModel, FlowModel
from .ball import frames_of
from .base import Attack, is_of_package, run_attack
from .evaluation import in_lockstep
from .loss import Loss
from .problem import Pair
from .registry import ATTACKS, CONTROLS, attack_spec
from .result import Attacked, norms_of
from .user_attacks import OwnAttack, register_attack, registered_attack, with_target_registered

AnyAttack = str | Attack | Any
"""The name of an attack, an attack from `load_attack`, or the user's own attack as an object or class."""

_ROUNDING = 0.05


def list_attacks() -> list[str]:
    """Return all names that `load_attack` accepts: controls first, attacks from installed packages last.

    >>> list_attacks()[:3]
    ['random_sign', 'random_gauss', 'random_patch']
    """
    return list(ATTACKS.names())


def load_attack(name: AnyAttack, **options: Any) -> Attack:
    """Build an attack from its name and options."""
    if isinstance(name, Attack):
        if options:
            raise UsageError(next(iter(options)), f"the attack {name.name} is already built and accepts no options")
        if not (isinstance(name, OwnAttack) or is_of_package(type(name))):
            register_attack(type(name))  # workers build it from its label
        return name
    if not isinstance(name, str):
        return OwnAttack.of(register_attack(name), **options)
    spec = attack_spec(name)
    if registered_attack(spec.name) is not None and not spec.argument:
        return OwnAttack.of(spec.name, **spec.options, **options)
    kind: type[Attack] = ATTACKS.get(spec.name)
    if spec.argument and not kind.argument:
        raise UsageError(name, f"options of attack {spec.name} are written option=value, not '{spec.argument}'")
    return kind.made(**({kind.argument: spec.argument} if spec.argument else {}), **spec.options, **options)


def with_controls(attacks: Iterable[AnyAttack]) -> tuple[str, ...]:
    """Return the labels of attacks, without duplicates, after those of their controls. Call this only with names that
    the user entered, because names of the form `module.path:Attribute` are imported.
    """
    asked: list[str] = []
    own: dict[str, Any] = {}
    for attack in attacks:
        loaded = load_attack(with_target_registered(attack) if isinstance(attack, str) else attack)
        made = registered_attack(loaded.name)
        if own.setdefault(loaded.name, made) is not made:
            raise UsageError(loaded.name, "two attacks have this name: give each a different `name`")
        asked.append(loaded.label)
    controls = (attack_spec(label).control for label in asked)
    return tuple(dict.fromkeys((*CONTROLS, *controls, *asked))) if asked else ()


def attack(
    frame1: Frame,
    frame2: Frame,
    model: Any,
    name: AnyAttack = "apgd",
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
        frame1, frame2: RGB uint8 frames (H, W, 3) of equal size.
        model: a name for `load_model`, or any model object that `evaluate` accepts.
        name: name of the attack, or your own attack; see `load_attack`.
        severity: 1 (mild) to 5 (severe); 3 by default.
        budget: limit of the change in the attack's norm, instead of a severity: the largest or the root mean square
            change in grey levels (0 to 255), or the changed share of a frame in %.
        flow: ground truth, float32 (H, W, 2), pixels; an untargeted attack moves the model's flow away from it, or from
            the model's flow on the clean frames if it is not given.
        valid: bool (H, W), True where the ground truth is known; everywhere by default.
        seed: random seed; the random numbers also depend on the severity and on `key`, the name of the pair.
        options: options of the attack.

    Returns:
        The attacked frames, rounded to 8 bits, with flows, norms and costs.

    Raises:
        UsageError: unknown attack or option, both a severity and a budget, or a mask without ground truth.
        ModelError: the attack needs gradients, which the model does not provide.
        DataError: the frames are not RGB uint8 of equal size, or the ground truth does not match them in size.

    >>> import robustflow as rf
    >>> frame = (np.arange(64 * 96 * 3) % 251).astype(np.uint8).reshape(64, 96, 3)
    >>> attacked = rf.attack(frame, np.roll(frame, 2, 1), "dis", "square", severity=2, queries=20)
    >>> attacked.linf, attacked.evaluations
    (2.0, 20)
    """
    if severity is not None and budget is not None:
        raise UsageError("budget", "give a severity or a budget, not both")
    chosen = load_attack(name, **options)
    loaded = load_model(model) if isinstance(model, str) else as_model(model, "the model")
    if not isinstance(loaded, FlowModel):
        raise ModelError("model", "only two-frame models, with predict(frame1, frame2), can be attacked")
    _check(frame1, frame2, flow, valid)
    level = 0 if budget is not None else check_severity(3 if severity is None else severity)
    grey = chosen.budget(level) if budget is None else budget
    pair = Pair((frame1, frame2), grey, flow, valid, key, seed, level)
    clean_flow = predict_checked(loaded, pair.frames, key, "clean", 0)
    warnings = first_warnings(loaded, pair.frames, key, clean_flow)
    return attack_pairs(chosen, loaded, [(pair, clean_flow)], warnings)[0]


def pair_of_sample(attack: Attack, sample: Sample, severity: int, seed: int) -> Pair:
    """Return a sample as a pair to be attacked, with the attack's budget at the given severity."""
    first, second = sample.frames[:2]
    return Pair((first, second), attack.budget(severity), sample.flow, sample.valid, sample.key, seed, severity)


def first_warnings(model: FlowModel, frames: tuple[Frame, Frame], key: str, first: Flow) -> frozenset[str]:
    """Check whether a model is deterministic, that is, predicts the same flow twice for the same pair."""
    again = predict_checked(model, frames, key, "clean", 0)
    return frozenset() if np.array_equal(first, again, equal_nan=True) else frozenset({"answers_differ"})


def attack_pairs(
    attack: Attack,
    model: AnyModel,
    pairs: Sequence[tuple[Pair, Flow]],
    warnings: frozenset[str] = frozenset(),
) -> list[Attacked]:
    """Attack pairs whose clean flows are known, in lockstep (see `evaluation`)."""
    attack.check(model)
    return in_lockstep([partial(_attack_pair, attack, model, *pair, warnings) for pair in pairs])


def _attack_pair(attack: Attack, model: AnyModel, pair: Pair, clean_flow: Flow, warnings: frozenset[str]) -> Attacked:
    problem = attack.begun(model, pair, clean_flow)
    ball, loss = problem.ball, problem.loss
    images = problem.checked(run_attack(attack, problem, pair.stream(attack.name)), attack.name)
    evaluations, gradients = problem.evaluations, problem.gradients
    frames = frames_of(ball.to_8_bits(images))
    assert isinstance(model, FlowModel)
    after = predict_checked(model, frames, pair.key, attack.name, 0)
    clean_loss, here = loss.of(clean_flow, weighted=False), loss.of(after, weighted=False)
    float_loss = problem.loss_at(images) if attack.needs_gradients else None
    warnings |= problem.troubles
    if float_loss is not None and abs(here - float_loss) > _ROUNDING * abs(float_loss - clean_loss):
        warnings |= {"rounding"}
    if not attack.control and not loss.score(here) > loss.score(clean_loss):
        warnings |= {"nothing_gained"}
        if images is problem.best:  # the clean pair is within every budget, and scores at least as high here
            images, frames, after, here = ball.clean, pair.frames, clean_flow, clean_loss
            float_loss = None if float_loss is None else clean_loss
    linf, rms, changed = norms_of(frames, pair.frames)
    return Attacked(
        attack=attack.name,
        budget=pair.budget,
        norm=attack.norm,
        frames=frames,
        flow=after,
        clean_flow=clean_flow,
        images=images.copy(),
        loss=here,
        clean_loss=clean_loss,
        float_loss=float_loss,
        linf=linf,
        rms=rms,
        changed=changed,
        way_gone=_way_gone(loss, clean_flow, after),
        late_gain=problem.late_gain,
        start_spread=problem.start_spread,
        trace=tuple(problem.trace),
        evaluations=evaluations,
        gradients=gradients,
        gradient=problem.gradient,
        warnings=tuple(sorted(warnings)),
    )


def _way_gone(loss: Loss, clean_flow: Flow, after: Flow) -> float | None:
    """Return the progress from the clean flow to the target, as a share of their distance; None without a target."""
    if not loss.towards:
        return None
    distance = Loss(loss.reference, loss.valid)
    at_first = distance.of(clean_flow)
    return 1 - distance.of(after) / at_first if at_first > 0 else None


def _check(frame1: Frame, frame2: Frame, flow: Flow | None, valid: Mask | None) -> None:
    check_frame(frame1, frame1, "frame 1")
    check_frame(frame2, frame1, "frame 2")
    if valid is not None and flow is None:
        raise UsageError("valid", "a mask of valid pixels needs ground truth; pass flow= as well")
    size = frame1.shape[:2]
    for name, array, shape, kind in (("flow", flow, (*size, 2), "f"), ("valid", valid, size, "b")):
        fits = isinstance(array, np.ndarray) and array.shape == shape and array.dtype.kind == kind
        if array is not None and not fits:
            wanted = "float32" if kind == "f" else "bool"
            raise DataError(name, f"it is {described_array(array)}; expected {wanted} {shape}, the size of the frames")
    if flow is not None and not np.isfinite(flow if valid is None else flow[valid]).all():
        raise DataError("flow", "the ground truth is NaN or infinite at valid pixels; exclude them from the mask")
