"""Add sensor noise by simulating the whole processing pipeline of a camera."""

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
    """State of a pair: the camera and its noise parameters; the streams of the frames are spawned from `stream`."""

    camera: CameraColours
    sensor: Sensor
    stream: Rng


class RawNoise(Corruption):
    """Simulates capturing the frame with a noisy sensor; `severities` are ISO numbers.

    The picture is converted back to the light on a sensor (`camera`, `mosaic`), exposed with photon and read noise
    (`exposure`), and developed again: denoising, white balance, demosaicing, colours, gamma and tone curve. Camera and
    gains are drawn once for the pair; the noise is independent in each frame. Excluded from the paper's averages.
    """

    name = "raw_noise"
    family = "sensor"
    paper_severities = (800, 1600, 3200, 6400, 12800)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> RawState:
        """Draw the camera, and the stream from which the frames' streams are spawned."""
        return RawState(draw_camera(rng.spawn("camera")), sensor_at(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: RawState, index: int) -> Frame:
        """Expose and develop one frame."""
        key = np.uint64(state.stream.spawn("frame", index).key)
        raw = exposed(light_on_sensor(frame, state.camera), state.sensor, key)
        return developed(raw, state.camera, denoise=state.sensor)
