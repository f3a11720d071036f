"""Check a user-defined corruption or attack before using it in a benchmark."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from ..attacks.api import load_attack
from ..attacks.ball import Images, images_of
from ..attacks.base import run_attack
from ..attacks.problem import Pair
from ..core.arguments import SEVERITIES
from ..core.errors import UsageError
from ..core.types import Camera, Flow, Frame, SceneDepth
from ..corruptions.api import load_corruption, stream_for
from ..corruptions.corruption import Corruption


def require(holds: Any, culprit: str, message: str) -> None:
    """Raise a `UsageError` unless a condition holds."""
    if not holds:
        raise UsageError(culprit, message)


def frames_of(shape: tuple[int, int]) -> list[Frame]:
    """Return test frames (H, W, 3): a texture, the same texture shifted by one pixel, black, and white."""
    rows, columns = np.indices(shape)
    texture = np.stack([(rows * 7 + columns * step) % 256 for step in (3, 5, 11)], axis=-1).astype(np.uint8)
    return [texture, np.roll(texture, 1, axis=1), np.zeros_like(texture), np.full_like(texture, 255)]


_SHAPES = ((48, 64), (33, 61))
"""An even and an odd frame size, which reveal bugs in code that halves an image."""
_PERIOD, _PHASES, _BLOCK, _AMPLITUDE = 64, 4, 16, 100.0
_READABLE = 0.01
"""Fraction of the amplitude below which the waves of a block cannot be read, e.g. because an object hides them."""
_WAVES, _MOST_MOVED = (128, 128), 2.0
"""Size of the frames on which displacement is measured, and largest mean displacement of a corruption that leaves the
ground truth unchanged, in pixels; for `psf_blur` it is 1.4 px, for `elastic_transform` at least 3.2 px."""


def displacement(
    corruption: Corruption,
    severity: int,
    shape: tuple[int, int],
    index: int = 0,
    seed: int = 0,
    depth: SceneDepth | None = None,
) -> npt.NDArray[np.float64]:
    """Measure how far content moves, with frames whose grey values code the position."""
    state = corruption.draw_with_depth(stream_for(corruption, severity, seed, "displacement"), severity, shape, depth)
    shifts = []
    for places in np.indices(shape)[::-1]:
        angles = 2 * np.pi * places / _PERIOD
        read = np.zeros(shape, np.complex128)
        for turn in 2 * np.pi * np.arange(_PHASES) / _PHASES:
            wave = np.rint(127.5 + _AMPLITUDE * np.cos(angles + turn)).astype(np.uint8)
            out = corruption.apply(wave[..., None].repeat(3, axis=2), state, index)
            read += out.mean(axis=2) * np.exp(-1j * (angles + turn))
        rows, columns = (size // _BLOCK for size in shape)
        tiles = read[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
        mean = tiles.mean(axis=(1, 3)) * (2 / (_PHASES * _AMPLITUDE))
        shifts.append(np.where(np.abs(mean) > _READABLE, np.angle(mean) * _PERIOD / (2 * np.pi), np.nan))
    return np.stack(shifts, axis=2)


def distortion(first: npt.NDArray[np.float64], second: npt.NDArray[np.float64]) -> float:
    """Return by how many pixels two frames are distorted: the mean deviation from the shift common to both, or 0 if no
    waves can be read.
    """
    both = np.stack([first, second]).reshape(-1, 2)
    both = both[np.isfinite(both).all(axis=1)]
    return float(np.hypot(*(both - both.mean(axis=0)).T).mean()) if len(both) else 0.0


def check_corruption(corruption: Any, seed: int = 0) -> str:
    """Check a corruption at all five severities, and return its name.

    Every returned frame must be RGB uint8 of the input's shape, and the input frame must not be modified. The same draw
    must return the same bytes, even in a different order and from a second instance of the class. Frame 0 must not
    depend on whether frame 1 is requested. Black, white and textured frames of even and odd sizes must work. A
    corruption that needs depth is tested on a floor in front of a wall, with known and unknown camera motion, and only
    on frames 0 and 1. Unless its `truth` is "none", a corruption must not move content by more than 2 px, apart from a
    shift of both frames by the same vector; this is measured with waves whose phase codes the position.

    Args:
        corruption: the corruption, as a class, an instance or a name; see docs/add-your-corruption.md.
        seed: the seed for the random draws.

    Raises:
        UsageError: a check failed; the message states the problem, the severity and the frame size.

    >>> import numpy as np
    >>> class Dim:
    ...     severities = (0.9, 0.8, 0.7, 0.6, 0.5)
    ...     def draw(self, rng, severity, shape):
    ...         return self.severities[severity - 1]
    ...     def apply(self, frame, state, index):
    ...         return np.rint(frame * state).astype(np.uint8)
    >>> check_corruption(Dim)
    'dim'
    """
    first, second = load_corruption(corruption), load_corruption(corruption)
    for severity in SEVERITIES:
        if first.severities[severity - 1] is not None:
            for shape in _SHAPES:
                _check_frames(first, second, severity, shape, seed)
            if first.truth == "unchanged":
                _check_content_stays(first, severity, seed)
    return first.name


def _check_frames(first: Corruption, second: Corruption, severity: int, shape: tuple[int, int], seed: int) -> None:
    where = f"at severity {severity} on {shape[0]}x{shape[1]} pixels it"
    frames, clean = frames_of(shape), frames_of(shape)
    scene = _scene(shape, severity % 2 == 0) if first.needs_depth else None

    def results(instance: Corruption, places: Iterable[int]) -> dict[int, Any]:
        state = instance.draw_with_depth(stream_for(instance, severity, seed, "check"), severity, shape, scene)
        return {place: instance.apply(frames[place], state, place % 2 if scene else place) for place in places}

    forth, back = results(first, range(len(frames))), results(second, reversed(range(len(frames))))
    for place, out in forth.items():
        require((frames[place] == clean[place]).all(), first.name, f"{where} modifies its input frame; copy it first")
        fits = isinstance(out, np.ndarray) and out.dtype == np.uint8 and out.shape == frames[place].shape
        require(fits, first.name, f"{where} does not return a uint8 array of shape {frames[place].shape}")
        shared = any(np.shares_memory(out, other) for other in (frames[place], *(forth[i] for i in range(place))))
        require(not shared, first.name, f"{where} returns its input or the same array twice; return a new one")
        require(
            (out == back[place]).all(),
            first.name,
            f"{where} returns different bytes for frame {place} on the second call or in a different order; draw all "
            "random numbers from `rng`, and those that differ between frames from rng.spawn('frame', index)",
        )


def _check_content_stays(corruption: Corruption, severity: int, seed: int) -> None:
    scene = _scene(_WAVES, True) if corruption.needs_depth else None
    moved = distortion(*(displacement(corruption, severity, _WAVES, index, seed, scene) for index in (0, 1)))
    require(
        moved <= _MOST_MOVED,
        corruption.name,
        f"at severity {severity} it moves content by {moved:.1f} px on average, so the ground truth does not describe "
        'the corrupted frames; set truth = "none"',
    )


def _scene(shape: tuple[int, int], moves: bool) -> SceneDepth:
    """Return the depth of a floor that extends to a wall 60 m away, with unknown values in one corner; in the second
    frame, the camera is one step closer.
    """
    height, width = shape
    rows = np.arange(height, 0, -1, dtype=np.float32)[:, None]
    first = np.minimum(np.float32(2) * height / (height + 1 - rows), np.float32(60)).repeat(width, axis=1)
    known = np.ones(shape, bool)
    known[: height // 4, : width // 4] = False
    motion = (np.eye(3), np.array([0.0, 0.0, -0.25])) if moves else (None, None)
    camera = Camera((float(width), float(width)), ((width - 1) / 2, (height - 1) / 2), *motion)
    return SceneDepth((first, first - np.float32(0.25)), (known, known), camera)


_SHAPES_ATTACKS = ((32, 40), (17, 23))
"""An even and an odd frame size."""


class _Smooth:
    """A model whose u and v are the tanh of weighted sums of a pixel's values in both frames; it has a gradient
    everywhere, and is implemented in NumPy and in PyTorch.
    """

    _weights = np.array([[[3, -2, 1], [-1, 2, -3]], [[-1, 1, 2], [2, -3, 1]]], np.float32) / 4

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        return self.flow(images_of(frame1, frame2))

    def flow(self, images: Images) -> Flow:
        values = images - np.float32(0.5)
        return np.asarray(10 * np.tanh(np.einsum("kfc,fchw->hwk", self._weights, values)), np.float32)

    def differentiable(self, images1: Any, images2: Any) -> Any:
        import torch

        values = torch.cat([images1, images2]) - 0.5
        return 10 * torch.tanh(torch.einsum("kfc,fchw->khw", torch.from_numpy(self._weights), values))[None]


def check_attack(attack: Any, seed: int = 0) -> str:
    """Check an attack on a small differentiable model at all five severities, and return the attack's name.

    The result must be float32, have the pair's shape, and lie within the budget both before and after rounding to 8
    bits. No other pair that the attack evaluated within the budget may score higher. The attack must not modify the
    given frames, and must return the same bytes for the same seed, even from a second instance of the class. It must
    work with and without ground truth, and on textured, black and white frames of even and odd sizes.

    Args:
        attack: the attack, as a class, an instance or a name; see docs/add-your-attack.md.
        seed: the seed for the random choices.

    Raises:
        UsageError: a check failed; the message states the problem, the severity and the frame size.

    >>> class Flip:
    ...     needs_gradients = False
    ...     def run(self, problem, rng):
    ...         ball = problem.ball
    ...         return ball.project(ball.clean + (2 * (ball.clean < 0.5) - 1) * ball.radius)
    >>> check_attack(Flip)
    'flip'
    """
    first, second = load_attack(attack), load_attack(attack)
    model = _Smooth()
    for shape in _SHAPES_ATTACKS:
        for severity in SEVERITIES:
            where = f"at severity {severity} on {shape[0]}x{shape[1]} pixels it"
            texture, shifted, black, white = frames_of(shape)
            for frames in ((texture, shifted), (black, white)):
                truth = np.zeros((*shape, 2), np.float32) if severity % 2 else None
                pair = Pair(frames, first.budget(severity), truth, None, "check", seed, severity)
                before = [frame.copy() for frame in frames]
                problem = first.problem(model, pair, model.predict(*frames))
                images = run_attack(first, problem, pair.stream(first.name))
                inside = problem.checked(images, first.name) is images
                require(inside, first.name, f"{where} exceeds its budget; end with problem.ball.project(images)")
                unchanged = all(map(np.array_equal, frames, before))
                require(unchanged, first.name, f"{where} modifies its input frames; copy them first")
                score = problem.loss.score(problem.loss.of(model.flow(images), weighted=False))
                require(
                    not problem.trace or score >= problem.best_score - 1e-4,
                    first.name,
                    f"{where} returns a pair with score {score:.4g} but evaluated one with score "
                    f"{problem.best_score:.4g}; return problem.best",
                )
                again = second.problem(model, pair, model.predict(*frames))
                same = np.array_equal(images, run_attack(second, again, pair.stream(second.name)))
                require(same, first.name, f"{where} returns different bytes again; draw all random numbers from `rng`")
    return first.name
