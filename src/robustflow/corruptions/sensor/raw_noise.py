"""Sensor noise, simulated with the complete processing pipeline of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from .camera import CameraColours, draw_camera
from .exposure import Sensor, exposed, sensor_at
from .mosaic import developed, light_on_sensor


@dataclass(frozen=True)
class RawState:
    """State for a pair: the camera and its noise parameters; `stream` is the parent of both frames' random streams."""

    camera: CameraColours
    sensor: Sensor
    stream: Rng


class RawNoise(Corruption):
    """Simulates capturing the frames with a noisy sensor; severities are ISO numbers.

    Each frame is converted back to the light on the sensor (`camera`, `mosaic`), exposed with photon and read noise
    (`exposure`), and developed again: denoising, white balance, demosaicing, colours, gamma and tone curve. The camera
    and its gains are drawn once per pair; the noise is independent in each frame. This corruption is excluded from the
    paper's averages.
    """

    name = "raw_noise"
    family = "sensor"
    paper_severities = (800, 1600, 3200, 6400, 12800)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> RawState:
        """Sample the camera and the parent of the frames' random streams."""
        return RawState(draw_camera(rng.spawn("camera")), sensor_at(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: RawState, index: int) -> Frame:
        """Expose and develop frame `index`, 0 or 1."""
        key = np.uint64(state.stream.spawn("frame", index).key)
        raw = exposed(light_on_sensor(frame, state.camera), state.sensor, key)
        return developed(raw, state.camera, state.sensor)
