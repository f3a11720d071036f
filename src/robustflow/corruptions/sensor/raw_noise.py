"""Sensor noise, simulated with the complete processing pipeline of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from .camera import CameraColours, draw_camera
from .exposure import NOISELESS, Sensor, exposed, exposed_without_noise, sensor_at
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
    (`exposure`), and developed again: denoising, white balance, demosaicing, colours, gamma and tone curve. The
    difference from a development without noise and denoising is added to the frame, because the frame has been
    demosaiced before: without noise it stays as it is. The camera and its gains are drawn once per pair; the noise is
    independent in each frame. This corruption is excluded from the paper's averages.
    """

    name = "raw_noise"
    family = "sensor"
    paper_severities = (800, 1600, 3200, 6400, 12800)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> RawState:
        """Sample the camera and the parent of the frames' random streams."""
        return RawState(draw_camera(rng.spawn("camera")), sensor_at(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: RawState, index: int) -> Frame:
        """Add to frame `index`, 0 or 1, what the noise changes when it is exposed and developed."""
        key = np.uint64(state.stream.spawn("frame", index).key)
        light = light_on_sensor(frame, state.camera)
        noisy = developed(exposed(light, state.sensor, key), state.camera, state.sensor)
        clean = developed(exposed_without_noise(light), state.camera, NOISELESS)
        return np.clip(frame + (noisy.astype(np.int16) - clean), 0, 255).astype(np.uint8)
