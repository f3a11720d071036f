"""Rain and snow as particles in the 3D scene, which form streaks and a veil in both frames.

The particles are a Poisson process in space, sampled once per pair within the region visible in either frame. Their
velocities are constant, so frame 2 shows them where wind and gravity have carried them in `FRAME_INTERVAL` seconds; the
camera motion adds parallax. If the camera motion is unknown, the camera is assumed to be at rest. "Down" is the y axis
of frame 1.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, njit
from ...core.errors import UsageError
from ...core.rng import Rng, hash64, natural_log
from ...core.types import Camera, DepthMap, Frame, SceneDepth
from ..corruption import DepthCorruption
from .scene import FRAME_INTERVAL, STILL, Motion, motion_of, moved, transmission, veiled

Points = npt.NDArray[np.float64]
"""Positions in metres or velocities in metres per second, float64 (n, 3)."""

EXPOSURE = 0.002
"""Exposure time in seconds: the longest exposure of the KITTI cameras."""
NEAREST = 0.3
"""Minimum distance in metres between the camera and a particle."""
_LENS_DIAMETER, _FOCUS = 0.002, 10.0
"""Aperture diameter and focus distance of the camera in metres; they only affect the blur of near particles."""
_PIXEL = 1.0
"""Blur radius in pixels of a point in focus, caused by the lens and the pixel."""
_SMALLEST = 6e-4
"""Particles with a diameter below this fraction of the image's longer side form the veil (0.75 px at a width of
1242 px).
"""
_MARGIN = 0.05
"""Margin around the image, as a fraction of the longer side, in which particles are sampled because their streaks may
extend into the image.
"""
_MOST = 1_000_000


class Sizes(NamedTuple):
    """Exponential size distribution: `density * exp(-slope * D)` particles per cubic metre and millimetre."""

    density: float  # density in 1 / (m^3 mm)
    slope: float  # slope in 1 / mm
    largest: float  # largest diameter in mm


class Fall(NamedTuple):
    slowest: float
    """Minimum speed in m/s; the terminal speed is `slowest + spread * u + root * sqrt(D)`, u in (0, 1], D in mm."""
    spread: float  # range of the random part of the speed, in m/s
    root: float  # diameter-dependent part of the speed at a diameter of 1 mm, in m/s
    wind: float  # maximum wind speed in m/s; the wind is horizontal and the same for all particles
    flutter: float  # maximum random deviation of a particle's velocity along each axis, in m/s


class Particles(NamedTuple):
    """Particles in the camera coordinates of each frame."""

    positions: tuple[Points, Points]  # positions at the time of each frame, in metres
    velocities: tuple[Points, Points]  # velocities relative to the ground, in m/s
    diameters: npt.NDArray[np.float64]  # diameters in metres, float64 (n,)
    lenses: npt.NDArray[np.float64]  # intrinsics fx, fy, cx, cy of each frame, float64 (2, 4)
    motion: Motion  # camera motion from frame 1 to frame 2


def draw_particles(rng: Rng, sizes: Sizes, fall: Fall, shape: tuple[int, int], camera: Camera) -> Particles:
    """Sample the particles for a pair; the random key of particle i is a hash of i."""
    height, width = shape
    margin = _MARGIN * max(shape)
    reach = camera.focal[0] * 1e-3 / (_SMALLEST * max(shape))
    lenses = np.array([camera.intrinsics(index) for index in (0, 1)], np.float64)
    spread = (width + 2 * margin) * (height + 2 * margin) / (lenses[:, 0] * lenses[:, 1])
    # particles are sampled up to the distance reach * D, so after integrating over space,
    # D^3 exp(-slope D) remains to be integrated over sizes
    squared = sizes.slope * sizes.slope
    counts = spread * (reach * reach * reach) / 3 * 6 * sizes.density / (squared * squared)
    if not counts.max() < _MOST:
        raise UsageError(
            "camera",
            f"would see {counts.max():.3g} particles: its focal length of {camera.focal[0]:g} px is not "
            f"plausible for a frame of {height}x{width} px; check the intrinsics",
        )
    motion = motion_of(camera) or STILL
    wind = _wind(rng.spawn("wind"), fall.wind)
    numbers = (counts + rng.uniform()).astype(np.int64)
    table = np.empty((numbers.sum(), 13))
    keys = np.array([rng.spawn("frame", index).key for index in (0, 1)], np.uint64)
    box = np.array([-0.5 - margin, -0.5 - margin, width + 2 * margin, height + 2 * margin, reach])
    count = _draw(keys, numbers, box, lenses, np.array(sizes), np.array([*fall, *wind]), *motion, table)
    parts = [table[:count, first : first + 3].copy() for first in (0, 3, 6, 9)]  # contiguous, as after unpickling
    return Particles((parts[0], parts[2]), (parts[1], parts[3]), table[:count, 12].copy(), lenses, motion)


def veil_of(sizes: Sizes, shape: tuple[int, int], camera: Camera) -> tuple[float, float]:
    """Return (extinction coefficient in 1/m, start distance in metres) for particles too small to draw individually.

    >>> rain = Sizes(8000.0, 1.5588, 6.0)  # 100 mm/h
    >>> [round(value, 4) for value in veil_of(rain, (375, 1242), Camera((721.0, 721.0), (609.0, 172.0)))]
    [0.0066, 1.8621]
    """
    cubed = sizes.slope * sizes.slope * sizes.slope
    start = camera.focal[0] * 1e-3 / (_SMALLEST * max(shape)) * 3 / sizes.slope
    return 1e-6 * 3.141592653589793 * sizes.density / cubed, max(start, NEAREST)


def streaks_of(particles: Particles, index: int) -> npt.NDArray[np.float64]:
    """Compute the streak of each particle in front of the camera in frame `index`: float64 (n, 7)."""
    lens = particles.lenses[index]
    out = np.empty((len(particles.diameters), 7))
    count = _project(
        particles.positions[index], particles.velocities[index], particles.diameters, lens, *particles.motion, out
    )
    return out[:count]


def _wind(rng: Rng, fastest: float) -> tuple[float, float]:
    """Sample the wind (x, z) in m/s, uniformly in a disk."""
    while True:
        x, z = rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0)
        if x * x + z * z <= 1:
            return fastest * x, fastest * z


@inner
def _uniform(key: Any, place: int) -> Any:
    """Return a uniformly distributed multiple of 2**-53 in (0, 1]."""
    return (np.float64(hash64(key, np.uint64(place)) >> np.uint64(11)) + 1.0) * 2.0**-53


@inner
def _in_view(x: Any, y: Any, z: Any, diameter: Any, box: Any, lens: Any) -> Any:
    """Return whether a position is within the region in which particles are sampled for one camera."""
    if z < NEAREST or z > box[4] * diameter:
        return False
    column, row = lens[0] * x / z + lens[2] - box[0], lens[1] * y / z + lens[3] - box[1]
    return 0 <= column < box[2] and 0 <= row < box[3]


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(
    keys: Any, numbers: Any, box: Any, lenses: Any, sizes: Any, fall: Any, rotation: Any, translation: Any, out: Any
) -> int:
    """Fill rows with the positions and velocities in both frames and the diameter; return the number of rows."""
    count = 0
    still, uniform = np.zeros(3), np.empty(13)
    for frame in range(2):
        lens = lenses[frame]
        for i in range(numbers[frame]):
            key = hash64(keys[frame], np.uint64(i))
            for place in range(uniform.size):
                uniform[place] = _uniform(key, place)
            product = uniform[0] * uniform[1] * uniform[2] * uniform[3]
            diameter = -natural_log(product) / sizes[1]
            z = box[4] * diameter * max(uniform[4], max(uniform[5], uniform[6]))
            if diameter > sizes[2] or z < NEAREST:
                continue
            x = (box[0] + box[2] * uniform[7] - lens[2]) / lens[0] * z
            y = (box[1] + box[3] * uniform[8] - lens[3]) / lens[1] * z
            vx = fall[5] + fall[4] * (2.0 * uniform[9] - 1.0)
            vy = fall[0] + fall[1] * uniform[10] + fall[2] * np.sqrt(diameter)
            vy = vy + fall[4] * (2.0 * uniform[11] - 1.0)
            vz = fall[6] + fall[4] * (2.0 * uniform[12] - 1.0)
            if frame == 1:
                dx, dy, dz = x - translation[0], y - translation[1], z - translation[2]
                x = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz - FRAME_INTERVAL * vx
                y = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz - FRAME_INTERVAL * vy
                z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz - FRAME_INTERVAL * vz
                if _in_view(x, y, z, diameter, box, lenses[0]):
                    continue
            row = out[count]
            row[0], row[1], row[2], row[3], row[4], row[5] = x, y, z, vx, vy, vz
            x, y, z = x + FRAME_INTERVAL * vx, y + FRAME_INTERVAL * vy, z + FRAME_INTERVAL * vz
            row[6], row[7], row[8] = moved(rotation, translation, x, y, z)
            row[9], row[10], row[11] = moved(rotation, still, vx, vy, vz)
            row[12] = diameter * 1e-3
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _project(
    positions: Any, velocities: Any, diameters: Any, lens: Any, rotation: Any, translation: Any, out: Any
) -> int:
    """Project the particles' paths during the exposure into the image; return the number of particles kept."""
    count = 0
    part = 0.5 * EXPOSURE / FRAME_INTERVAL
    for i in range(diameters.size):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        nx, ny, nz = moved(
            rotation,
            translation,
            x + FRAME_INTERVAL * velocities[i, 0],
            y + FRAME_INTERVAL * velocities[i, 1],
            z + FRAME_INTERVAL * velocities[i, 2],
        )
        dx, dy, dz = part * (nx - x), part * (ny - y), part * (nz - z)
        if z < NEAREST or z - dz < 0.5 * NEAREST or z + dz < 0.5 * NEAREST:
            continue
        row = out[count]
        row[0], row[1] = lens[0] * (x - dx) / (z - dz) + lens[2], lens[1] * (y - dy) / (z - dz) + lens[3]
        row[2], row[3] = lens[0] * (x + dx) / (z + dz) + lens[2], lens[1] * (y + dy) / (z + dz) + lens[3]
        row[4] = z
        row[5] = 0.5 * lens[0] * diameters[i] / z
        row[6] = _PIXEL + 0.5 * lens[0] * _LENS_DIAMETER * abs(1.0 / z - 1.0 / _FOCUS)
        count += 1
    return count


class PrecipitationState(NamedTuple):
    particles: Particles
    depth: tuple[DepthMap, DepthMap]  # depth maps of both frames, in metres
    veil: tuple[float, float]
    """Veil formed by small particles: (extinction coefficient in 1/m, start distance in metres)."""


class Precipitation(DepthCorruption):
    """Adds particles of a single colour, each of which hides the background for a fraction of the exposure.

    A particle that covers a pixel for a fraction a of the exposure changes the pixel x to (1 - a) x + a * colour; for a
    particle of diameter 2 r and a streak of length L, a is 2 r / L. A particle is drawn as a disk with a soft edge as
    wide as the blur caused by the lens and the pixel at that depth; however small the particle is, its weights
    over all pixels have the same sum as those of a sharp disk. Pixels closer than the particle are unchanged.
    """

    colour: ClassVar[tuple[float, float, float]]
    fall: ClassVar[Fall]

    @abstractmethod
    def sizes(self, rate: float) -> Sizes:
        """Return the particle size distribution for a rate in mm of water per hour."""

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> PrecipitationState:
        sizes, shape = self.sizes(self.parameter(severity)), depth.maps[0].shape
        particles = draw_particles(rng, sizes, self.fall, shape, depth.camera)
        return PrecipitationState(particles, depth.maps, veil_of(sizes, shape, depth.camera))

    def apply(self, frame: Frame, state: PrecipitationState, index: int) -> Frame:
        depth = np.ascontiguousarray(state.depth[index])
        density, start = state.veil
        passed = transmission(depth, state.particles.lenses[index], density, start)
        _cover(streaks_of(state.particles, index), depth, passed)
        return veiled(frame, passed, np.array(self.colour, np.float32))


@njit(cache=True, nogil=True, error_model="numpy")
def _cover(streaks: Any, depth: Any, passed: Any) -> None:
    """Multiply `passed` by the fraction of light that each streak transmits at each pixel."""
    height, width = depth.shape
    for i in range(len(streaks)):
        x0, y0, dx, dy = streaks[i, 0], streaks[i, 1], streaks[i, 2] - streaks[i, 0], streaks[i, 3] - streaks[i, 1]
        z, radius, soft = streaks[i, 4], streaks[i, 5], streaks[i, 6]
        length = np.sqrt(dx * dx + dy * dy)
        if length < 0.1:  # too short to have a well-defined direction
            x0, y0 = x0 + 0.5 * dx - 0.05, y0 + 0.5 * dy
            length, dx, dy = 0.1, 0.1, 0.0
        outer, inner = radius + soft, max(radius - soft, 0.0)
        outer2, inner2 = outer * outer, inner * inner
        gain = 2.0 * radius * radius / ((outer2 + inner2) * (outer2 - inner2) * length)
        ux, uy = dx / length, dy / length
        top = np.int64(np.ceil(max(min(y0, y0 + dy) - outer, 0.0)))
        bottom = np.int64(np.floor(min(max(y0, y0 + dy) + outer, height - 1.0)))
        for y in range(top, bottom + 1):
            low, high = min(x0, x0 + dx) - outer, max(x0, x0 + dx) + outer
            if abs(uy) > 0.01:
                middle, reach = x0 + (y - y0) * ux / uy, outer / abs(uy)
                low, high = max(low, middle - reach), min(high, middle + reach)
            left, right = np.int64(np.ceil(max(low, 0.0))), np.int64(np.floor(min(high, width - 1.0)))
            row, scene = passed[y], depth[y]
            for x in range(left, right + 1):
                if z > scene[x]:
                    continue
                along = (x - x0) * ux + (y - y0) * uy
                across = (y - y0) * ux - (x - x0) * uy
                across = across * across
                share = _path_integral(outer2 - across, along, length) - _path_integral(inner2 - across, along, length)
                row[x] = row[x] * np.float32(1.0 - gain * max(share, 0.0))


@njit(cache=True, nogil=True, inline="always")
def _path_integral(square: Any, along: Any, length: Any) -> Any:
    """Return the integral of max(square - (along - s)^2, 0) over s in [0, length]."""
    if square <= 0.0:
        return 0.0
    half = np.sqrt(square)
    a, b = max(-half, along - length), min(half, along)
    if b <= a:
        return 0.0
    return square * (b - a) - (b * b * b - a * a * a) / 3.0


class Rain3d(Precipitation):
    """Adds raindrops that move consistently between the frames with gravity and wind, and are occluded by the scene."""

    name = "rain_3d"
    paper_severities = (10.0, 25.0, 50.0, 100.0, 200.0)
    colour = (228.0, 232.0, 236.0)
    # 200 sqrt(D / 2000) m/s for D in mm
    fall = Fall(slowest=0.0, spread=0.0, root=4.47213595499958, wind=4.0, flutter=0.1)

    def sizes(self, rate: float) -> Sizes:
        # rounded, because the last bit of a power differs between machines
        return Sizes(8000.0, round(4.1 * rate**-0.21, 6), 6.0)


_SWELLING = 2.154
"""Ratio of a flake's diameter to its melted diameter; the density of snowflakes is a tenth of that of water."""


class Snow3d(Precipitation):
    """Adds snowflakes that move consistently between the frames with gravity and wind, and are occluded by the
    scene.
    """

    name = "snow_3d"
    paper_severities = (1.0, 2.0, 4.0, 7.0, 10.0)
    colour = (240.0, 242.0, 245.0)
    fall = Fall(slowest=1.0, spread=1.0, root=0.0, wind=3.0, flutter=0.5)

    def sizes(self, rate: float) -> Sizes:
        # rounded, because the last bit of a power differs between machines
        density = round(3800.0 * rate**-0.87 / _SWELLING, 6)
        return Sizes(density, round(2.55 * rate**-0.48 / _SWELLING, 6), 15.0)
